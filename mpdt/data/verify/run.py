"""Run: some rows of one task played to their ends, and where two such plays differ first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.sim.simulators import make_batch
from mpdt.data.spec.family import Family, Task
from mpdt.seeding import SeedKey


@dataclass(frozen=True)
class Run:
    """Some rows of one task, and what they are given to do; picklable.

    Shapes: actions (B, H, A).
    """

    family: Family
    task: Task
    keys: tuple[SeedKey, ...]
    actions: NDArray[np.float32]
    options: Mapping[str, float | bool]

    def rows(self, chosen: slice) -> Run:
        """Some of its rows."""
        return replace(self, keys=self.keys[chosen], actions=self.actions[chosen])


@dataclass(frozen=True)
class Seen:
    """What a run showed: (H + 1, B, D), (H, B), (H, B); only rows that had not ended count."""

    observations: NDArray[np.float64]
    rewards: NDArray[np.float64]
    ends: NDArray[np.bool_]

    def lengths(self) -> NDArray[np.int64]:
        """Steps of each row (B,)."""
        ended = self.ends.any(axis=0)
        return np.where(ended, self.ends.argmax(axis=0) + 1, len(self.ends))


def play(run: Run, env: Any = None) -> Seen:
    """Reset and step to the end of every row."""
    batch = env or make_batch(run.family, [run.task] * len(run.keys), run.options)
    first = batch.reset(run.keys, batch.draw_goals(run.keys))
    observations, rewards, ends = [first.copy()], [], []
    over = np.zeros(len(run.keys), np.bool_)
    for step in range(run.actions.shape[1]):
        result = batch.step(run.actions[:, step])
        # What comes behind the end of a row is of no episode.
        observations.append(np.where(over[:, None], 0.0, result.observations))
        rewards.append(np.where(over, 0.0, result.rewards))
        ends.append(result.terminations & ~over)
        over = over | result.terminations
    return Seen(np.stack(observations), np.stack(rewards), np.stack(ends))


def difference(run: Run, one: Seen, two: Seen) -> str:
    """Where they first differ, or nothing."""
    for step in range(len(one.observations)):
        if step and (wrong := _rows(one.rewards[step - 1], two.rewards[step - 1])):
            return f"task {run.task.name}, step {step - 1}, row {wrong[0]}: another reward"
        if wrong := _rows(one.observations[step], two.observations[step]):
            at = "reset" if step == 0 else f"step {step - 1}"
            columns = np.flatnonzero(one.observations[step][wrong[0]]
                                     != two.observations[step][wrong[0]])  # fmt: skip
            name = run.family.columns[int(columns[0])] if len(columns) else "sign of zero"
            return f"task {run.task.name}, {at}, row {wrong[0]}: another {name}"
        if step and (wrong := _rows(one.ends[step - 1], two.ends[step - 1])):
            return f"task {run.task.name}, step {step - 1}, row {wrong[0]}: another end"
    return ""


def _rows(one: NDArray[Any], two: NDArray[Any]) -> list[int]:
    return [row for row in range(len(one)) if one[row].tobytes() != two[row].tobytes()]
