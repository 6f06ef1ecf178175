"""Demonstrations: the right steps of the right task, drawn by step, and blind to actions in HDT."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from mpdt.model.demonstrations import DemonstrationPrompts, HyperPrompts
from mpdt.model.policy import PolicyBatch, embed
from mpdt.model.returns import ReturnTable
from mpdt.model.tokens import InputMap, InputSettings

N, B, K, D, A, S = 2, 3, 2, 4, 2, 64


@pytest.fixture
def inputs() -> InputMap:
    words = torch.randn((256, S), generator=torch.Generator().manual_seed(0))
    settings = InputSettings(kind="trained", return_to_go="none", time_table=9)
    return InputMap(settings, D, A, words, torch.zeros(D), torch.ones(D))


@pytest.fixture
def bank() -> PolicyBatch:
    generator = torch.Generator().manual_seed(1)
    return PolicyBatch(
        observations=torch.randn((N, B, K, D), generator=generator),
        previous_actions=torch.randn((N, B, K, A), generator=generator),
        returns_to_go=torch.zeros(N, B, K),
        timesteps=torch.zeros(N, B, K, dtype=torch.long),
        mask=torch.ones(N, B, K, dtype=torch.bool),
        actions=torch.randn((N, B, K, A), generator=generator),
    )


RETURNS = ReturnTable(*(torch.ones(N) for _ in range(4)))


def test_a_prompt_is_one_demonstration_of_the_task(inputs: InputMap, bank: PolicyBatch) -> None:
    prompts = DemonstrationPrompts(inputs, bank, RETURNS)
    tokens, _ = embed(inputs, bank)
    torch.testing.assert_close(prompts.task_prompts(torch.tensor([1])), tokens[1:, 0])
    seen = set()
    for step in range(20):
        drawn = prompts.task_prompts(torch.tensor([0, 1]), step)
        again = prompts.task_prompts(torch.tensor([0, 1]), step)
        assert torch.equal(drawn, again), "a function of (seed, step)"
        for task in (0, 1):
            own = [torch.allclose(drawn[task], tokens[task, i], atol=1e-5) for i in range(B)]
            assert sum(own) == 1
            seen.add((task, own.index(True)))
    assert len(seen) == N * B, "every demonstration has its turn"


def test_all_of_a_task_stands_in_its_demonstration(inputs: InputMap, bank: PolicyBatch) -> None:
    prompts = DemonstrationPrompts(inputs, bank, RETURNS)
    assert torch.equal(prompts.cross * prompts.task_parts(), prompts.task_prompts())
    other = prompts.showing(replace(bank, observations=bank.observations + 1), RETURNS)
    assert not torch.equal(other.task_prompts(), prompts.task_prompts())
    assert other.inputs is prompts.inputs


def test_a_hyper_network_sees_no_actions_and_starts_without_adapters(
    inputs: InputMap, bank: PolicyBatch
) -> None:
    prompts = HyperPrompts(inputs, bank, RETURNS, num_layers=3, rank=5, width=S)
    weights = prompts.task_prompts().unflatten(1, (3, 2, 5))
    assert weights.shape == (N, 3, 2, 5, S)
    assert not weights[:, :, 1].any() and weights[:, :, 0].any()
    assert not torch.equal(weights[0, 0], weights[0, 1]), "each layer has its own"
    shuffled = replace(bank, actions=bank.actions + 1, previous_actions=bank.actions)
    assert torch.equal(prompts.showing(shuffled, RETURNS).task_prompts(), prompts.task_prompts())
    other = prompts.showing(replace(bank, observations=bank.observations + 1), RETURNS)
    assert not torch.equal(other.task_prompts(), prompts.task_prompts())
