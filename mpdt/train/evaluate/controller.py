"""The trained policy as a controller of `evaluate`: one soft prompt and one target per task."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mpdt.model.closed_loop import ClosedLoop
from mpdt.model.policy import PromptPolicy
from mpdt.model.returns import ReturnTable
from mpdt.seeding import SeedKey
from mpdt.train.evaluate.rollout import Controller


class PromptController:
    """Rows of several tasks at once, each behind its task's prompt.

    Args:
        prompts: (n, l, s), one per evaluated task.
        returns: n rows; the closed loop starts from their `target`.
        window: K, as in training.
    """

    def __init__(
        self,
        policy: PromptPolicy,
        prompts: Tensor,
        returns: ReturnTable,
        window: int,
        low: float,
        high: float,
    ) -> None:
        self._policy, self._prompts, self._returns = policy, prompts.detach(), returns
        self._window, self._low, self._high = window, low, high
        self._loop: ClosedLoop | None = None
        self._paid: NDArray[np.float32] | None = None

    def begin(self, tasks: NDArray[np.int64], keys: Sequence[SeedKey]) -> None:
        self._loop = ClosedLoop(
            self._policy, self._prompts, torch.from_numpy(tasks), self._window,
            self._returns, self._low, self._high,
        )  # fmt: skip
        self._paid = None

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        assert self._loop is not None, "begin() comes first"
        actions: NDArray[np.float32] = self._loop.act(observations, self._paid)
        return actions

    def paid(self, rewards: NDArray[np.float32]) -> None:
        self._paid = rewards


class PerTaskController:
    """A controller of its own for every task; each knows one task, its number 0."""

    def __init__(self, controllers: Sequence[Controller]) -> None:
        self._controllers = controllers
        self._rows: list[tuple[Controller, NDArray[np.int64]]] = []

    def begin(self, tasks: NDArray[np.int64], keys: Sequence[SeedKey]) -> None:
        self._rows = []
        for task in np.unique(tasks):
            rows = np.flatnonzero(tasks == task)
            own = self._controllers[task]
            own.begin(np.zeros(len(rows), np.int64), [keys[row] for row in rows.tolist()])
            self._rows.append((own, rows))

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        parts = [own.act(observations[rows]) for own, rows in self._rows]
        actions = np.empty((len(observations), parts[0].shape[1]), np.float32)
        for (_, rows), part in zip(self._rows, parts, strict=True):
            actions[rows] = part
        return actions

    def paid(self, rewards: NDArray[np.float32]) -> None:
        for own, rows in self._rows:
            own.paid(rewards[rows])
