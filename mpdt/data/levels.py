"""Levels: what each quality of each task returned, and whether the qualities are what they say.

level = (return - random) / (expert - random)        0 = random, 1 = expert
required per task: random < medium < expert, and 0.35 <= level(medium) <= 0.65
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mpdt.data.plan import Plan
from mpdt.data.runner import BlockReport
from mpdt.errors import DataError

MEDIUM_RANGE = (0.35, 0.65)


@dataclass(frozen=True)
class TaskLevels:
    """Mean return per quality or reference of one task; NaN where it has no episodes.

    `random` and `expert` come from the stored episodes, or from reference episodes of the same
    policies where that quality is not stored.
    """

    task: str
    zero: float
    random: float
    medium: float
    expert: float
    history: float

    @property
    def medium_level(self) -> float:
        """Normalised return of medium; NaN without all three."""
        spread = self.expert - self.random
        return (self.medium - self.random) / spread if spread else float("nan")

    def faults(self) -> list[str]:
        """What is wrong with the qualities of this task, one line each."""
        found = []
        if self.random >= self.expert:
            found.append(f"expert {self.expert:.1f} is not above random {self.random:.1f}")
        elif self.medium <= self.random or self.medium >= self.expert:
            found.append(
                f"medium {self.medium:.1f} is not between random {self.random:.1f} "
                f"and expert {self.expert:.1f}"
            )
        elif not np.isnan(self.medium):
            low, high = MEDIUM_RANGE
            if not low <= self.medium_level <= high:
                found.append(
                    f"medium {self.medium:.1f} has level {self.medium_level:.2f}, "
                    f"outside [{low}, {high}] (random {self.random:.1f}, expert {self.expert:.1f})"
                )
        return [f"{self.task}: {fault}" for fault in found]


def measure_levels(plan: Plan, reports: Iterable[BlockReport]) -> dict[str, TaskLevels]:
    """Mean returns per task name, in the plan's task order."""
    returns: dict[tuple[str, str], list[float]] = {}
    for report in reports:
        if report.block.kind != "tta":
            key = (report.block.task.name, report.block.name)
            returns.setdefault(key, []).extend(report.returns.tolist())

    def mean(task: str, name: str) -> float:
        values = returns.get((task, name), [])
        return float(np.mean(values)) if values else float("nan")

    names = ("zero", "random", "medium", "expert", "history")
    return {
        task.name: TaskLevels(task.name, *(mean(task.name, name) for name in names))
        for task in plan.tasks
    }


def check_levels(plan: Plan, levels: dict[str, TaskLevels], parts: str) -> list[str]:
    """Refuse data whose qualities are not in order.

    Returns: the same complaints as warnings for a smoke version, whose few episodes decide
    nothing.

    Raises: DataError naming every task concerned and its returns.
    """
    faults = [fault for task in levels.values() for fault in task.faults()]
    if not faults or "smoke" in plan.spec.version:
        return faults
    raise DataError(
        "\n  ".join(["the qualities are not in order, so nothing was written", *faults]),
        where=plan.spec.name,
        hint=f"raise behaviour.rungs or the episode counts, or choose another behaviour; "
        f"the parts are kept in {parts}",
    )
