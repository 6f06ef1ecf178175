"""Task inference: arithmetic by hand, goals found again, and what it may read."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from mpdt.errors import TrainingError, UsageError
from mpdt.train.adapt.infer import (
    InferSettings,
    RewardModel,
    Transitions,
    convex_fit,
    explain,
    fit_reward_model,
    read_transitions,
)

QUICK = InferSettings(hidden=32, steps=400, batch=128, lr=1e-2)


def speeds(goal, seed, num=600):
    """One observation, the speed; reward -|speed - goal|. Speeds reach to both sides of it."""
    generator = np.random.Generator(np.random.PCG64(seed))
    inputs = generator.uniform(0, 4, (num, 3)).astype(np.float32)
    return Transitions(inputs, -np.abs(inputs[:, 0] - np.float32(goal)))


@pytest.fixture(scope="module")
def model():
    torch.set_num_threads(1)
    return fit_reward_model([speeds(goal, i) for i, goal in enumerate((1, 2, 3))], QUICK, seed=0)


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


def test_a_goal_between_two_is_their_mixture(model):
    """2.25: three quarters of 2 and a quarter of 3, as far as this small model can tell."""
    found = explain(model, speeds(2.25, 9), tasks=2)
    assert found.weights[0] == 0 and found.weights.sum() == pytest.approx(1)
    assert found.weights[1] == pytest.approx(0.75, abs=0.2)
    assert found.named("abc").keys() == {"b", "c"}
    assert found.errors[1] == pytest.approx(0.25, abs=0.1)  # |2.25 - 2| nearly everywhere


def test_a_trained_goal_is_found_and_can_be_held_out(model):
    x = speeds(1, 8)
    assert explain(model, x, tasks=1).weights.tolist() == [1, 0, 0]
    held_out = explain(model, x, tasks=2, banned=[0])
    assert held_out.weights[0] == 0 and held_out.weights[1] > 0.8


def test_the_fit_is_a_function_of_its_seed():
    data, settings = [speeds(1, 0), speeds(2, 1)], InferSettings(hidden=4, steps=3, batch=8)
    first, again, other = (fit_reward_model(data, settings, seed) for seed in (1, 1, 2))
    x = torch.from_numpy(speeds(1, 5).inputs)
    assert torch.equal(first(x), again(x)) and not torch.equal(first(x), other(x))


def test_refusals():
    broken = Transitions(np.zeros((4, 3), np.float32), np.full(4, np.nan, np.float32))
    with pytest.raises(TrainingError, match=r"adapt\.infer: the reward model's loss is nan"):
        fit_reward_model([broken], QUICK, 0)
    with pytest.raises(UsageError, match=r"adapt\.infer\.tasks"):
        InferSettings(tasks=0)


def test_columns_without_spread_do_not_divide_by_zero():
    still = Transitions(np.ones((4, 3), np.float32), np.ones(4, np.float32))
    assert torch.isfinite(RewardModel([still], 4, 0)(torch.ones(1, 3))).all()
