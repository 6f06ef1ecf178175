"""A language model is loaded whole, or one error says what does not fit."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from mpdt.errors import BackboneError
from mpdt.model.backbone import load_backbone

KINDS = ("random:tiny", "random:tiny-llama")
UP = {"random:tiny": "h.1.mlp.c_fc.weight", "random:tiny-llama": "layers.1.mlp.up_proj.weight"}

Tensors = dict[str, Tensor]


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def folder(kind: str, tmp_path: Path) -> Path:
    load_backbone(kind, dtype="float32", seed=4).model.save_pretrained(tmp_path / "lm")
    return tmp_path / "lm"


def rewrite(folder: Path, change: Callable[[Tensors], Tensors]) -> None:
    file = folder / "model.safetensors"
    save_file(change(load_file(file)), file, metadata={"format": "pt"})


def configure(folder: Path, **fields: Any) -> None:
    file = folder / "config.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | fields))


def load(folder: Path, depth: int | None = None) -> Any:
    return load_backbone(str(folder), depth, "float32")


def test_heads_and_blocks_left_out_on_purpose_are_no_misfit(folder: Path, kind: str) -> None:
    head = {"lm_head.weight": torch.zeros(256, 64), "score.weight": torch.zeros(2, 64)}
    rewrite(folder, lambda tensors: tensors | head)
    assert load(folder).fingerprint == load_backbone(kind, dtype="float32", seed=4).fingerprint
    assert load(folder, depth=1).num_layers == 1


def test_weights_with_the_prefix_of_their_head_are_whole(folder: Path, kind: str) -> None:
    prefix = "transformer." if kind == "random:tiny" else "model."
    rewrite(folder, lambda tensors: {prefix + name: value for name, value in tensors.items()})
    assert load(folder).fingerprint == load_backbone(kind, dtype="float32", seed=4).fingerprint


def test_what_a_compiled_model_left_says_how_to_save_it(folder: Path) -> None:
    rewrite(folder, lambda tensors: {f"_orig_mod.{k}": v for k, v in tensors.items()})
    with pytest.raises(BackboneError, match=r"does not fit .* found '_orig_mod") as caught:
        load(folder)
    assert "saved from a compiled model" in caught.value.hint


def test_missing_unknown_and_misshapen_tensors(folder: Path, kind: str) -> None:
    name = UP[kind]
    whole = load_file(folder / "model.safetensors")
    for change, message in (
        ({name: None}, f"'{name}' does not fit .* expected in the weights, found nothing"),
        ({"h.0.gate": torch.zeros(2)}, "'h.0.gate' .* expected no such tensor"),
        ({name: torch.zeros(3, 3)}, rf"'{name}' .* found \(3, 3\)"),
    ):
        changed = {k: v for k, v in (whole | change).items() if v is not None}
        rewrite(folder, lambda _, changed=changed: changed)
        with pytest.raises(BackboneError, match=message):
            load(folder)


def test_a_block_more_than_the_configuration_has_is_unknown(folder: Path, kind: str) -> None:
    more = UP[kind].replace(".1.", ".2.")
    rewrite(folder, lambda tensors: tensors | {more: tensors[UP[kind]].clone()})
    for depth in (None, 1):
        with pytest.raises(BackboneError, match="expected no such tensor"):
            load(folder, depth)


@pytest.mark.parametrize("keep", [0, 5, 7, 8, 100, -1])
def test_a_truncated_file(folder: Path, keep: int) -> None:
    file = folder / "model.safetensors"
    file.write_bytes(file.read_bytes()[:keep])
    with pytest.raises(BackboneError):
        load(folder)


def test_no_weights_and_pickled_weights(folder: Path) -> None:
    (folder / "model.safetensors").unlink()
    with pytest.raises(BackboneError, match=r"smaller than the configuration says; .*found 0"):
        load(folder)

    class Trap:
        def __reduce__(self) -> Any:
            return Path.touch, (folder / "RAN",)

    (folder / "pytorch_model.bin").write_bytes(pickle.dumps(Trap()))
    with pytest.raises(BackboneError):
        load(folder)
    assert not (folder / "RAN").exists()


@pytest.mark.parametrize(
    "fields",
    [
        {"vocab_size": 10**12}, {"num_hidden_layers": 10**9}, {"hidden_size": 10**9},
        {"n_embd": 10**9}, {"n_layer": 10**9}, {"intermediate_size": 10**10},
        {"hidden_size": "wide"}, {"num_hidden_layers": -3}, {"num_hidden_layers": None},
        {"num_attention_heads": 0}, {"n_head": 0}, {"model_type": ["gpt2"]}, {"vocab_size": {}},
        {"rope_parameters": {"rope_type": "no such"}}, {"activation_function": 3},
        {"hidden_act": "no such"}, {"quantization_config": {"quant_method": "gptq"}},
    ],
    ids=str,
)  # fmt: skip
def test_a_configuration_is_not_believed(folder: Path, fields: dict[str, Any]) -> None:
    """One error, or the model as it is where its kind does not know that word."""
    configure(folder, **fields)
    try:
        load(folder)
    except BackboneError as error:
        assert len(str(error)) < 1000


@pytest.mark.parametrize("text", ["", "[]", "[" * 2000, "\x00", '{"model_type": "gpt2"', "3"])
def test_a_configuration_that_is_none(folder: Path, text: str) -> None:
    (folder / "config.json").write_text(text)
    with pytest.raises(BackboneError):
        load(folder)


def test_code_of_theirs_does_not_run(folder: Path) -> None:
    (folder / "modeling_x.py").write_text("open('RAN', 'w')")
    configure(folder, auto_map={"AutoConfig": "modeling_x.C", "AutoModel": "modeling_x.M"})
    load(folder)
    assert not Path("RAN").exists()
