"""What the closed loop is handed: one prompt per task, the box, and each step's reward."""

from types import SimpleNamespace

import numpy as np
import torch

from mpdt.train.evaluate import controller
from mpdt.train.evaluate.controller import PromptController


def test_rewards_reach_the_next_step_and_a_new_episode_forgets_them(monkeypatch):
    calls = []

    class Loop:
        def __init__(self, policy, prompts, index, context, returns, low, high):
            calls.append((index.tolist(), context, low, high, prompts.requires_grad))

        def act(self, observations, previous_rewards):
            calls.append(None if previous_rewards is None else previous_rewards.tolist())
            return np.zeros((2, 1), np.float32)

    monkeypatch.setattr(controller, "ClosedLoop", Loop)
    prompts = torch.ones(2, 3, 4, requires_grad=True)
    acting = PromptController(SimpleNamespace(), prompts, SimpleNamespace(), 20, -2.0, 3.0)
    for _ in range(2):
        acting.begin(np.array([1, 0]), [])
        acting.act(np.zeros((2, 5), np.float32))
        acting.paid(np.array([7.0, 8.0], np.float32))
        acting.act(np.zeros((2, 5), np.float32))
    episode = [([1, 0], 20, -2.0, 3.0, False), None, [7.0, 8.0]]
    assert calls == episode * 2
