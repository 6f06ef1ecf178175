"""A bundle in the place of a ladder: who acts in the blocks of its roll-outs.

Workers get the folder's path and load it themselves, on one thread; whatever they load has to be
what was asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.collect.origin import Acted
from mpdt.data.episode import UNKNOWN_PROGRESS, PolicyInfo
from mpdt.data.sim.actors import Actions, Observations, Rewards, Rows
from mpdt.data.spec.tasks import Task
from mpdt.errors import DataError
from mpdt.seeding import Stream
from mpdt.train.bundle.acting import ActingPolicy
from mpdt.train.bundle.read import read_bundle
from mpdt.train.bundle.select import policy_of_bundle


@dataclass(eq=False)
class BundleLadder:
    """One policy for all tasks; it has no rungs.

    Args:
        fingerprint: of the policy in `folder`, without noise.
        start: name of the set of prompts.
        noise: standard deviation of what is added to actions, in their own unit.
    """

    folder: Path
    fingerprint: bytes
    start: str
    noise: float
    acted: Acted
    num_rungs: int = 1
    notice: str = ""
    weights: str = ""
    _policy: ActingPolicy | None = field(default=None, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_policy": None}

    def policy(self, task: Task, quality: str, block: int) -> tuple[TrainedPolicy, float]:
        """Who acts; nothing is loaded before it does."""
        return TrainedPolicy(self, task), UNKNOWN_PROGRESS

    def policies(self, tasks: Sequence[Task]) -> list[PolicyInfo]:
        return [self.acted.info(task.index) for task in tasks]

    def loaded(self, task: str) -> ActingPolicy:
        """Raises: as `read_bundle`; DataError for another policy than was asked for."""
        if self._policy is None:
            policy = policy_of_bundle(read_bundle(self.folder), task, self.start)
            if policy.fingerprint != self.fingerprint:
                raise DataError("another policy took its place meanwhile", where=str(self.folder),
                                expected=self.fingerprint.hex()[:12],
                                found=policy.fingerprint.hex()[:12],
                                hint="--restart begins anew with it")  # fmt: skip
            self._policy = policy
        return self._policy


class TrainedPolicy:
    """The policy on one task, with noise from stream POLICY of each row's key."""

    def __init__(self, ladder: BundleLadder, task: Task) -> None:
        self.info = ladder.acted.info(task.index)
        self._ladder, self._task = ladder, task
        self._noise: NDArray[np.float32] | None = None

    def begin(self, rows: Rows) -> None:
        self._policy = self._ladder.loaded(self._task.name)
        self._policy.reset([self._task.name] * len(rows.keys))
        if self._ladder.noise:
            shape = (rows.horizon, self._policy.family.action_size)
            draws = [key.generator(Stream.POLICY).standard_normal(shape, np.float32)
                     for key in rows.keys]  # fmt: skip
            self._noise = np.float32(self._ladder.noise) * np.stack(draws)

    def act(self, step: int, observations: Observations, rewards: Rewards | None = None) -> Actions:
        actions = self._policy.act_batch(observations, rewards)
        if self._noise is not None:
            actions = actions + self._noise[:, step]
            self._policy.acted(actions)  # clipped as the simulator's will be
        return actions
