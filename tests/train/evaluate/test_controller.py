"""What the closed loop is handed: one prompt per task, the box, and each step's reward."""

from types import SimpleNamespace

import numpy as np
import torch

from mpdt.data.sim.actors import Rows
from mpdt.train.evaluate import controller
from mpdt.train.evaluate.controller import PerTaskController, PromptController


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
        acting.begin(Rows((), tasks=np.array([1, 0])))
        acting.act(0, np.zeros((2, 5), np.float32))
        acting.act(1, np.zeros((2, 5), np.float32), np.array([7.0, 8.0], np.float32))
    episode = [([1, 0], 20, -2.0, 3.0, False), None, [7.0, 8.0]]
    assert calls == episode * 2


def test_an_actor_per_task_sees_its_own_rows_and_their_rewards():
    class Own:
        def __init__(self, name):
            self.name = name

        def begin(self, rows):
            self.rows = rows

        def act(self, step, observations, rewards=None):
            paid = 0 if rewards is None else rewards[:, None]
            return observations + 100 * self.name + 10 * step + paid

    one, two = Own(1), Own(2)
    acting = PerTaskController([one, two])
    acting.begin(Rows(["a", "b", "c"], horizon=7, tasks=np.array([1, 0, 1])))
    assert two.rows.keys == ["a", "c"] and two.rows.tasks.tolist() == [0, 0]
    assert one.rows.keys == ["b"] and one.rows.horizon == 7
    seen = np.array([[1], [2], [3]], np.float32)
    assert acting.act(0, seen).tolist() == [[201], [102], [203]]
    assert acting.act(1, seen, np.array([0.5, 0, 0.25])).tolist() == [[211.5], [112], [213.25]]
