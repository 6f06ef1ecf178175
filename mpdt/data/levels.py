"""Levels: what each quality of each task returned, and whether the qualities are what they say.

level = (return - random) / (expert - random)        0 = random, 1 = expert
required per task: random < medium < expert, and 0.35 <= level(medium) <= 0.65

A level is a mean over some episodes. Outside its band by no more than two of its standard
errors, it is a warning; further out, or with the order broken, nothing is written.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mpdt.data.plan import Plan
from mpdt.data.runner import BlockReport
from mpdt.errors import DataError

MEDIUM_RANGE = (0.35, 0.65)
ERRORS = 2  # standard errors outside MEDIUM_RANGE up to which nobody can tell


@dataclass(frozen=True)
class TaskLevels:
    """Mean return per quality or reference of one task; NaN where it has no episodes.

    `random` and `expert` come from the stored episodes, or from reference episodes of the same
    policies where that quality is not stored. `medium_error` is the standard error of
    `medium_level`; infinite where too few episodes tell it.
    """

    task: str
    zero: float
    random: float
    medium: float
    expert: float
    history: float
    medium_error: float

    @property
    def medium_level(self) -> float:
        """Normalised return of medium; NaN without all three."""
        spread = self.expert - self.random
        return (self.medium - self.random) / spread if spread else float("nan")

    @property
    def outside(self) -> float:
        """How far the level of medium lies outside MEDIUM_RANGE; 0 inside, and without medium."""
        low, high = MEDIUM_RANGE
        level = self.medium_level
        return 0.0 if np.isnan(level) else max(low - level, level - high, 0.0)

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
        elif self.outside > ERRORS * self.medium_error:
            found.append(f"{self._level_text()}, by more than {ERRORS} standard errors")
        return [f"{self.task}: {fault}" for fault in found]

    def doubts(self) -> list[str]:
        """What may be wrong, but lies within the error of the measurement; one line each."""
        if self.outside == 0 or self.faults():
            return []
        return [f"{self.task}: {self._level_text()}, but within {ERRORS} standard errors"]

    def _level_text(self) -> str:
        low, high = MEDIUM_RANGE
        return (
            f"medium {self.medium:.1f} has level {self.medium_level:.3f} +- "
            f"{self.medium_error:.3f} (random {self.random:.1f}, expert {self.expert:.1f}), "
            f"outside [{low}, {high}]"
        )


def measure_levels(plan: Plan, reports: Iterable[BlockReport]) -> dict[str, TaskLevels]:
    """Mean returns per task name, in the plan's task order, with the error of the level.

    Reports may come in any order: sums of floats depend on theirs, so blocks are put in the
    plan's first and the references in the file do not tell who finished when.
    """
    returns: dict[tuple[str, str], list[float]] = {}
    place = {block: number for number, block in enumerate(plan.blocks)}
    for report in sorted(reports, key=lambda report: place[report.block]):
        if report.block.kind != "tta":
            key = (report.block.task.name, report.block.name)
            returns.setdefault(key, []).extend(report.returns.tolist())

    def levels(task: str) -> TaskLevels:
        found = {name: np.array(returns.get((task, name), [])) for name in names}
        means = {name: float(v.mean()) if len(v) else float("nan") for name, v in found.items()}
        error = level_error(found["random"], found["medium"], found["expert"])
        return TaskLevels(task, **means, medium_error=error)

    names = ("zero", "random", "medium", "expert", "history")
    return {task.name: levels(task.name) for task in plan.tasks}


def level_error(
    random: npt.NDArray[np.float64],
    medium: npt.NDArray[np.float64],
    expert: npt.NDArray[np.float64],
) -> float:
    """Standard error of the level of medium, from returns (N,) of independent episodes each.

    To first order, with S = expert - random and var() that of a mean:
    var(level) = (var(medium) + (1 - level)^2 var(random) + level^2 var(expert)) / S^2.
    Infinite with fewer than two episodes of any of them.
    """
    if min(len(random), len(medium), len(expert)) < 2 or expert.mean() == random.mean():
        return float("inf")
    spread = expert.mean() - random.mean()
    level = (medium.mean() - random.mean()) / spread
    weights = ((medium, 1.0), (random, 1 - level), (expert, level))
    variance = sum(weight**2 * of.var(ddof=1) / len(of) for of, weight in weights)
    return float(np.sqrt(variance) / abs(spread))


def check_levels(plan: Plan, levels: dict[str, TaskLevels], parts: str) -> list[str]:
    """Refuse data whose qualities are not in order.

    Returns: warnings, of levels that lie outside their band by no more than their error; and
    every complaint about a smoke version, whose few episodes decide nothing.

    Raises: DataError naming every task concerned and its returns.
    """
    faults = [fault for task in levels.values() for fault in task.faults()]
    doubts = [doubt for task in levels.values() for doubt in task.doubts()]
    if not faults or "smoke" in plan.spec.version:
        return faults + doubts
    raise DataError(
        "\n  ".join(["the qualities are not in order, so nothing was written", *faults]),
        where=plan.spec.name,
        hint=f"{_remedy(plan)}; the parts are kept in {parts}",
    )


def _remedy(plan: Plan) -> str:
    name, behaviour = plan.spec.name, plan.spec.behaviour
    if behaviour.script is not None:
        return (
            f"mpdt-data calibrate {name} measures the mixing rates again, into this folder; "
            "collect then makes only the blocks of new rates again"
        )
    return (
        f"change behaviour.rungs (now {behaviour.rungs}; medium is the rung nearest level 0.5) "
        f"or behaviour.noise of {name} in datasets.yaml, or leave medium out of it"
    )
