from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from mpdt.errors import ShapeError, SpecError
from mpdt.model.backbone import Backbone
from mpdt.model.policy import HeadSettings, PolicyBatch, PromptPolicy, action_loss
from mpdt.model.prompts import DecomposedPrompts, PromptSettings
from mpdt.model.returns import ReturnTable
from mpdt.model.tokens import InputSettings

from .conftest import numbers, windows

D, A, LENGTH = 5, 2, 3


def make(backbone: Backbone, head: HeadSettings | None = None, **inputs: Any) -> PromptPolicy:
    """A policy whose time table says something, as after training."""
    settings = InputSettings(**{"return_to_go": "family", "time_table": 50, **inputs})
    statistics = (np.linspace(-1, 1, D), np.linspace(0.5, 2, D))
    policy = PromptPolicy(backbone, settings, head or HeadSettings(hidden=16), *statistics, A)
    if policy.inputs.time is not None:
        nn.init.normal_(policy.inputs.time, generator=torch.Generator().manual_seed(4))
    return policy


def unit_returns(n: int) -> ReturnTable:
    one = torch.ones(n)
    return ReturnTable(one, -9 * one, 9 * one, one)


def test_trainables_of_the_published_size() -> None:
    """ML45: P_c 23,040 + 45 x 798 + time table 768,000 + head 590,592 + 4 x 769 = 1,420,618."""

    class Wide(nn.Module):  # the shape of gpt2 without its 124 M numbers
        width, name, frozen = 768, "gpt2", True
        word_embeddings = numbers(400, 768)

    policy = PromptPolicy(
        Wide(),  # type: ignore[arg-type]
        InputSettings(time_table=1000), HeadSettings(), np.zeros(39), np.ones(39), 4,
    )  # fmt: skip
    prompts = DecomposedPrompts(PromptSettings(length=30, rank=1), 45, 768, spread=0.14)
    trainable = [p for m in (policy, prompts) for p in m.parameters() if p.requires_grad]
    assert sum(p.numel() for p in trainable) == 1_420_618


def test_the_label_is_not_visible_where_it_is_predicted(backbone: Backbone) -> None:
    """Changing a_3, R_4, s_4 or anything later leaves the predictions of a_0 ... a_3 alone."""
    for tokens_per_step in (1, 3):
        policy = make(backbone, tokens_per_step=tokens_per_step)
        batch, prompts = windows(1, 2, 6, D, A), numbers(1, LENGTH, backbone.width)
        before = policy(batch, prompts, unit_returns(1)).actions
        fields: dict[str, torch.Tensor] = {}
        for name in ("observations", "returns_to_go", "previous_actions", "actions"):
            changed = getattr(batch, name).clone()
            first = 3 if name == "actions" else 4  # previous_actions[4] is a_3
            changed[:, :, first:] = -changed[:, :, first:]
            fields[name] = changed
        after = policy(replace(batch, **fields), prompts, unit_returns(1)).actions
        difference = (before - after).abs().amax(dim=(0, 1, 3))
        assert difference[:4].max() == 0, tokens_per_step
        assert difference[4:].min() > 1e-4, tokens_per_step


@pytest.mark.parametrize("tokens_per_step", [1, 3])
def test_pads_do_not_reach_the_actions(backbone: Backbone, tokens_per_step: int) -> None:
    policy = make(backbone, tokens_per_step=tokens_per_step)
    batch, prompts = windows(2, 2, 6, D, A, pads=4), numbers(2, LENGTH, backbone.width)
    clean = policy(batch, prompts, unit_returns(2)).actions
    dirty = batch.observations.clone()
    dirty[~batch.mask] = torch.nan
    actions = policy(replace(batch, observations=dirty), prompts, unit_returns(2)).actions
    assert torch.equal(actions[batch.mask], clean[batch.mask])
    short = PolicyBatch(**{k: None if v is None else v[:, :1, 4:] for k, v in vars(batch).items()})
    bare = policy(short, prompts, unit_returns(2)).actions
    torch.testing.assert_close(clean[:, :1, 4:], bare, atol=1e-5, rtol=1e-5)


def test_each_task_has_its_own_prompt_and_return_scale(backbone: Backbone) -> None:
    policy = make(backbone)
    batch, prompts = windows(2, 2, 3, D, A), numbers(2, LENGTH, backbone.width)
    base = policy(batch, prompts, unit_returns(2)).actions
    other_prompt = policy(batch, prompts[[0, 0]], unit_returns(2)).actions
    scaled = replace(unit_returns(2), scale=torch.tensor([1.0, 5.0]))
    other_scale = policy(batch, prompts, scaled).actions
    for changed in (other_prompt, other_scale):
        torch.testing.assert_close(changed[0], base[0])
        assert (changed[1] - base[1]).abs().max() > 1e-3


def test_gradients_reach_prompts_table_and_head_only(backbone: Backbone) -> None:
    policy, prompts = make(backbone), numbers(1, LENGTH, backbone.width).requires_grad_()
    batch = windows(1, 2, 4, D, A, pads=1)
    output = policy(batch, prompts, unit_returns(1), layer_features=True)
    assert batch.actions is not None
    action_loss(output.actions, batch.actions, batch.mask).backward()
    moved = {name for name, p in policy.named_parameters() if p.grad is not None}
    head = {"head.1.weight", "head.1.bias", "head.3.weight", "head.3.bias"}
    assert moved == {"inputs.time", *head}
    assert prompts.grad is not None and prompts.grad.abs().min() > 0
    assert [f.shape for f in output.features] == [(1, 2, 4, backbone.width)] * 2


def test_features_of_three_tokens_are_those_that_predict(gpt2_shaped: Backbone) -> None:
    policy = make(gpt2_shaped, tokens_per_step=3)
    output = policy(windows(1, 2, 4, D, A), None, unit_returns(1), layer_features=True)
    assert output.features[1].shape == (1, 2, 4, 64)
    hidden = gpt2_shaped.model.ln_f(output.features[-1])
    torch.testing.assert_close(policy.head(hidden), output.actions)


def test_loss_worked_by_hand() -> None:
    """Two real steps, A = 2: (1 + 4)/2 and (0 + 9)/2 -> mean 3.5; the pad holds garbage."""
    predicted = torch.tensor([[[[torch.nan, 7.0], [1.0, 2.0], [0.0, 3.0]]]])
    mask = torch.tensor([[[False, True, True]]])
    assert action_loss(predicted, torch.zeros(1, 1, 3, 2), mask).item() == pytest.approx(3.5)


@pytest.mark.parametrize(
    ("settings", "layers", "count"),
    [
        (HeadSettings(), "LayerNorm Linear GELU Linear", 64 * 64 + 64 + 65 * A),
        (HeadSettings(hidden=0), "LayerNorm Linear", 65 * A),
        (HeadSettings(hidden=8, tanh=True, layer_norm=False), "Linear GELU Linear Tanh", 538),
        (HeadSettings(hidden=0, affine=True), "LayerNorm Linear", 128 + 65 * A),
    ],
)
def test_heads(gpt2_shaped: Backbone, settings: HeadSettings, layers: str, count: int) -> None:
    """hidden 8: 64 * 8 + 8 + 9 * 2 = 538."""
    policy = make(gpt2_shaped, settings)
    assert " ".join(type(layer).__name__ for layer in policy.head) == layers
    assert sum(p.numel() for p in policy.head.parameters()) == count
    if settings.tanh:
        huge = policy.head(1e4 * numbers(5, 64))
        assert huge.abs().max() <= 1


def test_own_state_restores_a_policy_and_refuses_another(gpt2_shaped: Backbone) -> None:
    batch, prompts = windows(1, 2, 3, D, A), numbers(1, LENGTH, 64)
    source, target = make(gpt2_shaped, kind="trained"), make(gpt2_shaped, kind="trained")
    with torch.no_grad():
        for p in source.parameters():
            if p.requires_grad:
                p.add_(0.1)
        source.inputs.mean.add_(1.0)
    assert not any(name.startswith("backbone.") for name in source.own_state())
    wanted = source(batch, prompts, unit_returns(1)).actions
    assert not torch.allclose(target(batch, prompts, unit_returns(1)).actions, wanted)
    target.load_own_state(source.own_state())
    assert torch.equal(target(batch, prompts, unit_returns(1)).actions, wanted)
    with pytest.raises(ShapeError, match=r"inputs\.time"):
        make(gpt2_shaped, kind="trained", time_table=0).load_own_state(source.own_state())


def test_windows_become_tensors() -> None:
    arrays = {name: value.numpy() for name, value in vars(windows(2, 3, 4, D, A)).items()}
    batch = PolicyBatch.from_windows(SimpleNamespace(**arrays))
    assert all(torch.equal(value, torch.from_numpy(arrays[k])) for k, value in vars(batch).items())


def test_returns_left_out_are_noticed(gpt2_shaped: Backbone) -> None:
    batch = windows(1, 1, 2, D, A)
    with pytest.raises(SpecError, match="got none"):
        make(gpt2_shaped)(batch, None)
    make(gpt2_shaped, return_to_go="none")(batch, None)


def test_head_start_leaves_the_global_generator_alone(gpt2_shaped: Backbone) -> None:
    state = torch.get_rng_state()
    one, two = make(gpt2_shaped), make(gpt2_shaped)
    assert torch.equal(state, torch.get_rng_state())
    assert torch.equal(one.head[1].weight, two.head[1].weight)
