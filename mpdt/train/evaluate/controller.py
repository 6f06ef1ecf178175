"""The trained policy as an actor of `evaluate`: one soft prompt and one target per task."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mpdt.data.sim.actors import Actions, Actor, Observations, Rewards, Rows
from mpdt.model.closed_loop import ClosedLoop
from mpdt.model.fingerprint import fingerprint
from mpdt.model.policy import PromptPolicy
from mpdt.model.returns import ReturnTable


class TrainedActor(Actor, Protocol):
    """An actor that can say who it is."""

    @property
    def fingerprint(self) -> bytes:
        """32 bytes that change with anything that its actions depend on."""
        ...


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

    @property
    def fingerprint(self) -> bytes:
        """32 bytes that change with anything that the actions depend on."""
        return fingerprint(self._policy, self._prompts, self._returns, self._window)

    def begin(self, rows: Rows) -> None:
        self._loop = ClosedLoop(
            self._policy, self._prompts, torch.from_numpy(rows.tasks), self._window,
            self._returns, self._low, self._high,
        )  # fmt: skip

    def act(self, step: int, observations: Observations, rewards: Rewards | None = None) -> Actions:
        assert self._loop is not None, "begin() comes first"
        actions: Actions = self._loop.act(observations, rewards)
        return actions


class PerTaskController:
    """An actor of its own for every task; each knows one task, its number 0."""

    def __init__(self, actors: Sequence[PromptController]) -> None:
        self._actors = actors
        self._rows: list[tuple[Actor, NDArray[np.int64]]] = []

    @property
    def fingerprint(self) -> bytes:
        """32 bytes that change with anything that any task's actions depend on."""
        return hashlib.sha256(b"".join(actor.fingerprint for actor in self._actors)).digest()

    def begin(self, rows: Rows) -> None:
        self._rows = []
        for task in np.unique(rows.tasks):
            places = np.flatnonzero(rows.tasks == task)
            keys = [rows.keys[place] for place in places.tolist()]
            own = self._actors[task]
            own.begin(replace(rows, keys=keys, tasks=np.zeros(len(places), np.int64)))
            self._rows.append((own, places))

    def act(self, step: int, observations: Observations, rewards: Rewards | None = None) -> Actions:
        parts = [
            own.act(step, observations[rows], None if rewards is None else rewards[rows])
            for own, rows in self._rows
        ]
        actions = np.empty((len(observations), parts[0].shape[1]), np.float32)
        for (_, rows), part in zip(self._rows, parts, strict=True):
            actions[rows] = part
        return actions
