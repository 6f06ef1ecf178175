from __future__ import annotations

from pathlib import Path

import pytest
import torch
from einops import rearrange, repeat
from torch import Tensor

from mpdt.errors import BackboneError, ShapeError
from mpdt.model.backbone import Backbone, load_backbone, positions_of, visible_to

from .conftest import left_padded, numbers

TINY = "random:tiny"


def plain_forward(backbone: Backbone, prompts: Tensor, tokens: Tensor, mask: Tensor) -> Tensor:
    """Slow twin: every window carries its own copy of the prompt; the library makes the mask."""
    n, M, _, _ = tokens.shape
    length = prompts.shape[1]
    inputs = torch.cat([repeat(prompts, "n l s -> (n M) l s", M=M),
                        rearrange(tokens, "n M K s -> (n M) K s")], dim=1)  # fmt: skip
    seen = torch.cat([torch.ones(n * M, length, dtype=torch.bool), mask.flatten(0, 1)], dim=1)
    positions = (seen.long().cumsum(dim=1) - 1).clamp(min=0)
    result = backbone.model(
        inputs_embeds=inputs, attention_mask=seen.long(), position_ids=positions, use_cache=False
    )
    return rearrange(result.last_hidden_state[:, length:], "(n M) K s -> n M K s", n=n)


def test_shared_prompt_equals_concatenation_in_outputs_and_gradients(backbone: Backbone) -> None:
    n, M, K, length = 2, 3, 5, 4
    mask = left_padded(n, M, K, pads=2)
    weight = numbers(n, M, K, backbone.width, seed=9) * mask[..., None]
    results = []
    for shared in (True, False):
        prompts = numbers(n, length, backbone.width).requires_grad_()
        tokens = numbers(n, M, K, backbone.width, seed=1).requires_grad_()
        if shared:
            hidden, _ = backbone(prompts, tokens, mask)
        else:
            hidden = plain_forward(backbone, prompts, tokens, mask)
        (hidden * weight).sum().backward()
        results.append((hidden[mask], prompts.grad, tokens.grad[mask]))
    for fast, slow in zip(*results, strict=True):
        assert slow.abs().max() > 0.1
        torch.testing.assert_close(fast, slow, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(results[0][0], results[1][0], atol=1e-5, rtol=1e-5)


def test_windows_of_one_task_do_not_mix_with_another(backbone: Backbone) -> None:
    prompts, tokens = numbers(2, 3, backbone.width), numbers(2, 2, 4, backbone.width, seed=1)
    mask = torch.ones(2, 2, 4, dtype=torch.bool)
    before, _ = backbone(prompts, tokens, mask)
    after, _ = backbone(torch.stack([prompts[0], -prompts[1]]), tokens, mask)
    torch.testing.assert_close(before[0], after[0])
    assert (before[1] - after[1]).abs().max() > 0.01


def test_mask_and_positions_worked_by_hand() -> None:
    mask = torch.tensor([[False, True, True]])
    # one prompt column; a pad sees the prompt and itself; nobody else sees the pad
    by_hand = [[1, 1, 0, 0], [1, 0, 1, 0], [1, 0, 1, 1]]
    assert visible_to(mask, 1)[0, 0].int().tolist() == by_hand
    assert positions_of(mask, 1).tolist() == [[1, 1, 2]]
    assert positions_of(torch.ones(1, 3, dtype=torch.bool), 30).tolist() == [[30, 31, 32]]


@pytest.mark.parametrize("length", [0, 4])
def test_pads_change_nothing(backbone: Backbone, length: int) -> None:
    prompts = numbers(1, length, backbone.width) if length else None
    window = numbers(1, 1, 3, backbone.width, seed=1)
    bare, _ = backbone(prompts, window, torch.ones(1, 1, 3, dtype=torch.bool))
    for pads, garbage in ((1, 0.0), (4, 0.0), (4, 1e3)):
        padded = torch.cat([garbage + numbers(1, 1, pads, backbone.width), window], dim=2)
        mask = torch.tensor([[[False] * pads + [True] * 3]])
        hidden, _ = backbone(prompts, padded, mask)
        assert hidden.isfinite().all()
        torch.testing.assert_close(hidden[:, :, pads:], bare, atol=1e-5, rtol=1e-5)


def test_a_token_changes_its_own_and_later_outputs_only(backbone: Backbone) -> None:
    prompts, tokens = numbers(1, 2, backbone.width), numbers(1, 1, 5, backbone.width, seed=1)
    mask = torch.ones(1, 1, 5, dtype=torch.bool)
    before, _ = backbone(prompts, tokens, mask)
    changed = tokens.clone()
    changed[:, :, 3] *= -1.0  # a shift would be invisible behind a LayerNorm
    after, _ = backbone(prompts, changed, mask)
    difference = (before - after).abs().amax(dim=-1)[0, 0]
    assert difference[:3].max() == 0
    assert difference[3:].min() > 1e-3


def test_features_are_the_outputs_of_each_block(backbone: Backbone) -> None:
    """The final norm of the last feature is the hidden vector; the first has no norm applied."""
    prompts, tokens = numbers(1, 2, backbone.width), numbers(1, 2, 4, backbone.width, seed=1)
    mask = left_padded(1, 2, 4, pads=1)
    hidden, features = backbone(prompts, tokens, mask, layer_features=True)
    assert len(features) == backbone.num_layers == 2
    norm = backbone.model.ln_f if "llama" not in backbone.name else backbone.model.norm
    torch.testing.assert_close(norm(features[-1]), hidden)
    assert not torch.allclose(norm(features[0]), hidden)
    assert not any(block._forward_hooks for block in backbone.blocks())


def test_depth_keeps_the_first_blocks(backbone: Backbone, tmp_path: Path) -> None:
    backbone.model.save_pretrained(tmp_path)
    shallow = load_backbone(str(tmp_path), depth=1, dtype="float32")
    assert (shallow.num_layers, len(shallow.blocks())) == (1, 1)
    deep = dict(backbone.model.named_parameters())
    assert all(torch.equal(v, deep[k]) for k, v in shallow.model.named_parameters())
    assert shallow.fingerprint != backbone.fingerprint
    prompts, tokens = numbers(1, 2, backbone.width), numbers(1, 2, 4, backbone.width, seed=1)
    mask = torch.ones(1, 2, 4, dtype=torch.bool)
    _, deep_features = backbone(prompts, tokens, mask, layer_features=True)
    _, features = shallow(prompts, tokens, mask, layer_features=True)
    torch.testing.assert_close(features, deep_features[:1])


def test_weights_stay_frozen_and_without_dropout(backbone: Backbone) -> None:
    prompts = numbers(1, 2, backbone.width).requires_grad_()
    backbone.train()
    tokens = numbers(1, 1, 3, backbone.width)
    hidden, _ = backbone(prompts, tokens, torch.ones(1, 1, 3, dtype=torch.bool))
    hidden.square().sum().backward()
    assert not any(module.training for module in backbone.modules())
    assert all(p.grad is None and not p.requires_grad for p in backbone.parameters())


def test_unfrozen_weights_learn_but_not_the_word_table() -> None:
    backbone = load_backbone(TINY, dtype="auto", frozen=False)
    assert backbone.dtype == torch.float32
    hidden, _ = backbone(None, numbers(1, 1, 3, 64), torch.ones(1, 1, 3, dtype=torch.bool))
    hidden.square().sum().backward()
    moving = {name for name, p in backbone.model.named_parameters() if p.grad is not None}
    assert "h.0.attn.c_attn.weight" in moving and "wte.weight" not in moving


@pytest.mark.parametrize("name", ["random:tiny", "random:tiny-llama"])
def test_blocks_go_on_without_their_words(name: str) -> None:
    whole, bare = load_backbone(name), load_backbone(name)
    bare.drop_words()
    assert whole.word_embeddings.shape == (256, 64) and bare.word_embeddings.shape == (0, 64)
    assert bare.fingerprint == whole.fingerprint
    tokens, mask = numbers(1, 2, 3, 64), torch.ones(1, 2, 3, dtype=torch.bool)
    prompts = numbers(1, 4, 64)
    assert torch.equal(whole(prompts, tokens, mask)[0], bare(prompts, tokens, mask)[0])


def test_prefix_serves_many_steps(backbone: Backbone) -> None:
    prefix = backbone.encode_prefix(numbers(2, 3, backbone.width)).select(torch.tensor([1, 0, 1]))
    tokens, mask = numbers(3, 2, backbone.width), torch.ones(3, 2, dtype=torch.bool)
    first, _ = backbone.forward_with_cache(prefix, tokens, mask)
    second, _ = backbone.forward_with_cache(prefix, tokens, mask)
    assert torch.equal(first, second)
    assert prefix.keys[0].shape[2] == 3


def test_fingerprint_names_the_weights_not_the_dtype() -> None:
    prints = {
        (dtype, seed): load_backbone(TINY, dtype=dtype, seed=seed).fingerprint
        for dtype in ("float32", "bfloat16")
        for seed in (0, 1)
    }
    assert prints["float32", 0] == prints["bfloat16", 0] != prints["float32", 1]


def test_bfloat16_stays_near_float32(backbone: Backbone) -> None:
    half = load_backbone(backbone.name, dtype="bfloat16", seed=3)
    prompts, tokens = numbers(1, 3, 64), numbers(1, 2, 5, 64, seed=1)
    mask = torch.ones(1, 2, 5, dtype=torch.bool)
    exact, rough = backbone(prompts, tokens, mask)[0], half(prompts, tokens, mask)[0]
    assert rough.dtype == torch.float32
    assert next(half.model.parameters()).dtype == torch.bfloat16
    # Rotary frequencies rounded to bfloat16 would misplace every token behind the first few.
    assert all(buffer.dtype == torch.float32 for buffer in half.model.buffers())
    assert 0 < (exact - rough).abs().mean() < 0.05 * exact.abs().mean()


def test_random_start_leaves_the_global_generator_alone() -> None:
    state = torch.get_rng_state()
    load_backbone(TINY, seed=5)
    assert torch.equal(state, torch.get_rng_state())


@pytest.mark.parametrize("depth", [0, 3])
def test_impossible_depth(depth: int) -> None:
    with pytest.raises(BackboneError, match="impossible depth; expected 1 to 2 blocks") as caught:
        load_backbone(TINY, depth=depth)
    assert f"found {depth}" in str(caught.value)


def test_too_long_and_misshapen_inputs(gpt2_shaped: Backbone) -> None:
    mask = torch.ones(1, 1, 200, dtype=torch.bool)
    with pytest.raises(BackboneError, match="at most 256 positions, found 60 \\+ 200"):
        gpt2_shaped(numbers(1, 60, 64), numbers(1, 1, 200, 64), mask)
    # Refused before the prompt is run: the positions of 300 are not there to be looked up.
    with pytest.raises(BackboneError, match="found 300 \\+ 200"):
        gpt2_shaped(numbers(1, 300, 64), numbers(1, 1, 200, 64), mask)
    with pytest.raises(BackboneError, match="found 257 \\+ 0"):
        gpt2_shaped.encode_prefix(numbers(1, 257, 64))
    with pytest.raises(ShapeError, match="the last of width 64"):
        gpt2_shaped(None, numbers(1, 1, 200, 63), mask)
    with pytest.raises(ShapeError, match="1 prompts, found 2"):
        gpt2_shaped(numbers(2, 3, 64), numbers(1, 1, 200, 64), mask)
