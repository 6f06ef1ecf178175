"""Blocks without their library answer as those of the library do, to the bit."""

from __future__ import annotations

import pytest
import torch

from mpdt.errors import BackboneError, ShapeError
from mpdt.model.backbone import Backbone, load_backbone
from mpdt.model.light import light_model, parts_of, shape_of
from mpdt.model.moving_window import MovingWindow, prompt_prefix

from .conftest import SHAPES, numbers

ROWS, LENGTH, MOST = 3, 5, 4


def light_twin(backbone: Backbone) -> Backbone:
    shape = shape_of(backbone.model)
    model = light_model(shape, parts_of(backbone.model, shape))
    return Backbone(backbone.name, model, backbone.dtype, whole=backbone.fingerprint)


def lived(backbone: Backbone, prompts: torch.Tensor) -> torch.Tensor:
    """Hidden vectors of six steps, the last two of which move the window."""
    prefix = prompt_prefix(backbone, prompts)
    window = MovingWindow(backbone, prefix, ROWS, MOST)
    tokens, real = numbers(ROWS, 6, backbone.width, seed=8), torch.ones(ROWS, dtype=torch.long)
    with torch.no_grad():
        return torch.stack([window.append(tokens[:, t : t + 1], real) for t in range(6)])


@pytest.mark.parametrize("dtype", ["float32", "bfloat16"])
@pytest.mark.parametrize("name", [*SHAPES, "random:prompt-dt"])
def test_the_same_bits(name: str, dtype: str) -> None:
    backbone = load_backbone(name, dtype=dtype, seed=3)  # type: ignore[arg-type]
    twin, prompts = light_twin(backbone), numbers(ROWS, LENGTH, backbone.width)
    with torch.no_grad():
        assert torch.equal(lived(backbone, prompts), lived(twin, prompts))
    assert twin.fingerprint == backbone.fingerprint
    assert twin.max_positions == backbone.max_positions
    assert twin.word_embeddings.shape == (0, backbone.width)


def test_trained_additions_are_inside(backbone: Backbone) -> None:
    own = load_backbone("random:tiny-llama", dtype="float32", seed=3)
    own.add_low_rank(2, 4.0, seed=1)
    with torch.no_grad():
        for name, value in own.named_parameters():
            if name.endswith(".up"):
                value.copy_(numbers(*value.shape))
        plain = load_backbone("random:tiny-llama", dtype="float32", seed=3)
        prompts = numbers(ROWS, LENGTH, own.width)
        assert torch.equal(lived(own, prompts), lived(light_twin(own), prompts))
        assert not torch.equal(lived(own, prompts), lived(plain, prompts))


@pytest.mark.parametrize("kind", ["linear", "llama3", "yarn"])
def test_stretched_angles_are_carried_as_numbers(kind: str) -> None:
    model = stretched(kind)
    backbone = Backbone("own", model, torch.float32)
    prompts = numbers(ROWS, LENGTH, backbone.width)
    assert torch.equal(lived(backbone, prompts), lived(light_twin(backbone), prompts))


def stretched(kind: str) -> torch.nn.Module:
    from transformers import LlamaConfig, LlamaModel

    rope = {
        "rope_type": kind, "rope_theta": 10000.0, "factor": 4.0,
        "original_max_position_embeddings": 64,
    }  # fmt: skip
    if kind == "llama3":
        rope |= {"low_freq_factor": 1.0, "high_freq_factor": 4.0}
    torch.manual_seed(0)
    return LlamaModel(LlamaConfig(
        vocab_size=32, hidden_size=32, intermediate_size=48, num_hidden_layers=2,
        num_attention_heads=2, num_key_value_heads=1, max_position_embeddings=256,
        rope_parameters=rope,
    )).eval()  # fmt: skip


def test_what_cannot_be_carried_says_so() -> None:
    with pytest.raises(BackboneError, match="cannot be carried") as caught:
        shape_of(stretched("dynamic"))
    assert "--without-backbone" in caught.value.hint
    backbone = load_backbone("random:tiny", dtype="float32")
    shape = shape_of(backbone.model)
    tensors = parts_of(backbone.model, shape)
    del tensors["ln_f.bias"]
    with pytest.raises(ShapeError, match=r"ln_f\.bias"):
        light_model(shape, tensors)


def test_a_prompt_s_keys_are_those_of_the_whole_pass(backbone: Backbone) -> None:
    prompts = numbers(ROWS, LENGTH, backbone.width)
    with torch.no_grad():
        whole, pieces = backbone.encode_prefix(prompts), prompt_prefix(backbone, prompts)
    assert pieces.length == whole.length
    for name in ("keys", "values"):
        for ours, theirs in zip(getattr(pieces, name), getattr(whole, name), strict=True):
            torch.testing.assert_close(ours, theirs, atol=1e-5, rtol=1e-5)
    alone = prompt_prefix(backbone, prompts[1:2])
    assert torch.equal(alone.keys[-1][0], pieces.keys[-1][1])
