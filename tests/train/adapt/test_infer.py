"""Task inference: goals found again, mixed and held out."""

import numpy as np
import pytest
import torch

from mpdt.train.adapt.infer import explain
from mpdt.train.fit.reward import RewardSettings, Transitions, fit_reward_model

QUICK = RewardSettings(hidden=32, steps=400, batch=128, lr=1e-2)


def speeds(goal, seed, num=600):
    """One observation, the speed; reward -|speed - goal|. Speeds reach to both sides of it."""
    generator = np.random.Generator(np.random.PCG64(seed))
    inputs = generator.uniform(0, 4, (num, 3)).astype(np.float32)
    return Transitions(inputs, -np.abs(inputs[:, 0] - np.float32(goal)))


@pytest.fixture(scope="module")
def model():
    torch.set_num_threads(1)
    return fit_reward_model([speeds(goal, i) for i, goal in enumerate((1, 2, 3))], QUICK, seed=0)


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
    assert explain(model, x, tasks=2, banned=[0, 1]).weights.tolist() == [0, 0, 1]
