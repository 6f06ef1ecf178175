from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from mpdt.errors import ShapeError, SpecError
from mpdt.model.backbone import Backbone
from mpdt.model.closed_loop import ClosedLoop
from mpdt.model.policy import PolicyBatch
from mpdt.model.returns import ReturnTable

from .conftest import numbers
from .test_policy import LENGTH, A, D, make, unit_returns

STEPS, K = 7, 4
INDEX = torch.tensor([1, 0, 1])
TABLE = ReturnTable(  # one row per prompt
    torch.tensor([2.0, 5.0]), torch.tensor([-1.0, -9.0]),
    torch.tensor([3.0, 9.0]), torch.tensor([3.0, 4.0]),
)  # fmt: skip


def window_of(live: dict[str, np.ndarray], end: int) -> PolicyBatch:
    """Slow twin: the training window of K steps up to `end`, left-padded, cut from the record.

    observations (B, T, D), actions (B, T, A), rewards (B, T), targets (B,).
    """
    B = live["observations"].shape[0]
    steps = list(range(end - K + 1, end + 1))
    batch: dict[str, list[Any]] = {key: [] for key in ("s", "p", "a", "R", "t", "m")}
    for step in steps:
        pad = step < 0
        t = max(step, 0)
        earlier = live["actions"][:, t - 1] if t else np.zeros((B, A))
        batch["s"].append(np.zeros((B, D)) if pad else live["observations"][:, t])
        batch["p"].append(np.zeros((B, A)) if pad else earlier)
        batch["a"].append(np.zeros((B, A)) if pad else live["actions"][:, t])
        batch["R"].append(live["targets"] - live["rewards"][:, :t].sum(axis=1))
        batch["t"].append(np.full(B, t))
        batch["m"].append(np.full(B, not pad))
    tensors = {k: torch.from_numpy(np.stack(v, axis=1)[:, None]) for k, v in batch.items()}
    return PolicyBatch(
        tensors["s"].float(), tensors["p"].float(), tensors["R"].float(),
        tensors["t"], tensors["m"], tensors["a"].float(),
    )  # fmt: skip


def live_through(loop: ClosedLoop, targets: np.ndarray, seed: int = 0) -> dict[str, np.ndarray]:
    """Act for STEPS steps on made-up observations and rewards; record as a data set would."""
    observations = numbers(3, STEPS, D, seed=seed).numpy()
    rewards = numbers(3, STEPS, seed=seed + 1).numpy().astype(np.float64)
    loop.reset(targets)
    actions = [loop.act(observations[:, t], rewards[:, t - 1] if t else None) for t in range(STEPS)]
    return {
        "observations": observations, "rewards": rewards,
        "actions": np.stack(actions, axis=1), "targets": targets,
    }  # fmt: skip


@pytest.mark.parametrize("tokens_per_step", [1, 3])
@pytest.mark.parametrize("clip", [True, False])
def test_acting_equals_training_windows(
    backbone: Backbone, tokens_per_step: int, clip: bool
) -> None:
    policy = make(backbone, tokens_per_step=tokens_per_step, return_clip=clip)
    prompts = numbers(2, LENGTH, backbone.width)
    loop = ClosedLoop(policy, prompts, INDEX, K, TABLE, action_low=-0.3, action_high=0.3)
    live = live_through(loop, np.array([2.0, 3.5, -1.0]))
    assert (np.abs(live["actions"]) == 0.3).any()  # some were clipped: the record must show it
    for end in range(STEPS):
        with torch.no_grad():
            output = policy(window_of(live, end), prompts[INDEX], TABLE.select(INDEX))
        expected = output.actions[:, 0, -1].numpy().clip(-0.3, 0.3)
        np.testing.assert_allclose(live["actions"][:, end], expected, atol=2e-5)


def test_a_second_episode_remembers_nothing(gpt2_shaped: Backbone) -> None:
    loop = ClosedLoop(make(gpt2_shaped), numbers(2, LENGTH, 64), INDEX, K, TABLE)
    first = live_through(loop, np.zeros(3), seed=0)
    other = live_through(loop, np.zeros(3), seed=5)
    again = live_through(loop, np.zeros(3), seed=0)
    assert np.array_equal(first["actions"], again["actions"])
    assert not np.allclose(first["actions"], other["actions"])


def test_targets_default_to_those_of_the_row_s_task(gpt2_shaped: Backbone) -> None:
    """Prompt indices 1, 0, 1 and targets 3, 4: rows start at 4, 3, 4."""
    loop = ClosedLoop(make(gpt2_shaped), numbers(2, LENGTH, 64), INDEX, K, TABLE)
    observation = numbers(3, D).numpy()
    default = loop.act(observation)
    loop.reset(np.array([4.0, 3.0, 4.0]))
    assert np.array_equal(loop.act(observation), default)
    loop.reset(np.array([0.0, 0.0, 0.0]))
    assert not np.allclose(loop.act(observation), default)


def test_rewards_lower_the_return_to_go_and_none_keeps_it(gpt2_shaped: Backbone) -> None:
    loop = ClosedLoop(make(gpt2_shaped), None, INDEX, K, TABLE)
    loop.reset(np.array([2.0, 2.0, 2.0]))
    loop.act(np.zeros((3, D)))
    loop.act(np.zeros((3, D)), np.array([0.5, -1.0, 0.0]))
    loop.act(np.zeros((3, D)))
    batch = loop._batch()
    assert batch.returns_to_go[:, 0].tolist() == [[2, 1.5, 1.5], [2, 3, 3], [2, 2, 2]]
    assert batch.timesteps[0, 0].tolist() == [0, 1, 2]


def test_window_holds_the_last_steps_only(gpt2_shaped: Backbone) -> None:
    loop = ClosedLoop(make(gpt2_shaped, return_to_go="none"), None, INDEX, 2)
    for step in range(4):
        loop.act(np.full((3, D), step, dtype=np.float32))
    batch = loop._batch()
    assert batch.observations[0, 0, :, 0].tolist() == [2, 3]
    assert batch.timesteps[2, 0].tolist() == [2, 3]


def test_rows_do_not_influence_each_other(gpt2_shaped: Backbone) -> None:
    """A finished row may hold anything, even NaN."""
    loop = ClosedLoop(make(gpt2_shaped), numbers(2, LENGTH, 64), INDEX, K, TABLE)
    observation = numbers(3, D).numpy()
    clean = loop.act(observation)
    loop.reset()
    observation[2] = np.nan
    np.testing.assert_allclose(loop.act(observation)[:2], clean[:2], atol=1e-6)


def test_no_gradient_and_float32(gpt2_shaped: Backbone) -> None:
    prompts = numbers(2, LENGTH, 64).requires_grad_()
    loop = ClosedLoop(make(gpt2_shaped), prompts, INDEX, K, TABLE)
    action = loop.act(np.zeros((3, D), dtype=np.float64))
    assert (action.dtype, action.shape) == (np.float32, (3, A))
    assert not loop._prefix.keys[0].requires_grad


def test_mistakes_of_the_caller(gpt2_shaped: Backbone) -> None:
    policy = make(gpt2_shaped)
    with pytest.raises(ShapeError, match="indices below 1, found 1"):
        ClosedLoop(policy, numbers(1, LENGTH, 64), INDEX, K, unit_returns(2))
    loop = ClosedLoop(policy, numbers(2, LENGTH, 64), INDEX, K, TABLE)
    with pytest.raises(ShapeError, match=r"observations of a closed loop; expected \(3, 5\)"):
        loop.act(np.zeros((2, D)))
    with pytest.raises(SpecError, match="before the first step"):
        loop.act(np.zeros((3, D)), np.zeros(3))
    with pytest.raises(ShapeError, match="targets"):
        loop.reset(np.zeros(2))
    with pytest.raises(SpecError, match="without a table"):
        ClosedLoop(policy, None, INDEX, K).reset(np.zeros(3))
