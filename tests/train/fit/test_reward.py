"""The reward model: arithmetic by hand, seeds, refusals."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from mpdt.errors import TrainingError, UsageError
from mpdt.train.fit.reward import (
    RewardModel,
    RewardSettings,
    Transitions,
    convex_fit,
    fit_reward_model,
    read_transitions,
)

QUICK = RewardSettings(hidden=4, steps=3, batch=8)


def test_convex_fit_by_hand():
    """1 lies a quarter of the way from 0 to 4; 5 lies beyond 4; three columns, one useless."""
    columns = np.array([[0.0, 4.0], [0.0, 4.0]])
    np.testing.assert_allclose(convex_fit(columns, np.array([1.0, 1.0])), [0.75, 0.25])
    np.testing.assert_allclose(convex_fit(columns, np.array([5.0, 5.0])), [0.0, 1.0])
    three = np.array([[0.0, 4.0, 9.0], [0.0, 0.0, -9.0]])
    np.testing.assert_allclose(convex_fit(three, np.array([2.0, 0.0])), [0.5, 0.5, 0.0], atol=1e-12)


def test_transitions_by_hand():
    """Two episodes of 2 and 1 steps, observations 0 1 4 | 9 7; actions are cut to the box."""
    steps = SimpleNamespace(
        observations=np.array([[0.0], [1], [4], [9], [7]]), actions=np.array([[3.0], [0], [-3]])
    )
    episodes = SimpleNamespace(start=[0, 2], obs_start=[0, 3], length=[2, 1])
    source = SimpleNamespace(steps=steps, episodes=episodes)
    found = read_transitions(source, np.array([1, 0]), np.array([5.0, 6, 7]), -1, 1)
    assert found.inputs.tolist() == [[9, -1, -2], [0, 1, 1], [1, 0, 3]]
    assert found.rewards.tolist() == [7, 5, 6]


def test_the_fit_is_a_function_of_its_seed():
    inputs = np.arange(18, dtype=np.float32).reshape(6, 3)
    data = [Transitions(inputs, inputs[:, 0]), Transitions(inputs, inputs[:, 1])]
    first, again, other = (fit_reward_model(data, QUICK, seed) for seed in (1, 1, 2))
    x = torch.from_numpy(inputs)
    assert torch.equal(first(x), again(x)) and not torch.equal(first(x), other(x))


def test_refusals():
    broken = Transitions(np.zeros((4, 3), np.float32), np.full(4, np.nan, np.float32))
    with pytest.raises(TrainingError, match=r"adapt\.infer: the reward model's loss is nan"):
        fit_reward_model([broken], QUICK, 0)
    with pytest.raises(UsageError, match=r"adapt\.infer\.tasks"):
        RewardSettings(tasks=0)


def test_columns_without_spread_do_not_divide_by_zero():
    still = Transitions(np.ones((4, 3), np.float32), np.ones(4, np.float32))
    assert torch.isfinite(RewardModel([still], 4, 0)(torch.ones(1, 3))).all()


def test_what_no_training_task_showed_counts_as_ten_standard_deviations():
    """Mean 0, standard deviation 1."""
    inputs = np.array([[-1.0], [1.0]], np.float32)
    model = RewardModel([Transitions(inputs, np.array([0.0, 1.0], np.float32))], 4, 0)
    near, edge, far = model(torch.tensor([[9.0], [10.0], [1e6]]))
    assert near != edge and edge == far


def test_no_weight_is_negative():
    """3 a - 2 b would fit exactly; of sums of two weights above 0 the first alone is nearest."""
    columns = np.array([[1.0, 0.0], [0.0, 1.0]])
    np.testing.assert_array_equal(convex_fit(columns, np.array([3.0, -2.0])), [1.0, 0.0])
