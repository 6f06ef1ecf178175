"""Levels: what each quality of each task returned, and whether the qualities are what they say.

level = (return - random) / (expert - random)        0 = random, 1 = expert
required per task: random < medium < expert, and 0.35 <= level(medium) <= 0.65

random and expert are the references on record (`sim/record.py`); a reference that is not
there is the mean of this collection's own episodes. A level is a mean over some episodes.
Outside its band by no more than two of its standard errors, it is a warning; further out, or
with the order broken, nothing is written.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from mpdt.data.collect.plan import Plan
from mpdt.data.collect.runner import BlockReport
from mpdt.data.reference import Reference, References, level
from mpdt.data.sim.constants import choose_constant, constant_actions
from mpdt.errors import DataError, Lines, quoted

MEDIUM_RANGE = (0.35, 0.65)
ERRORS = 2  # standard errors outside MEDIUM_RANGE up to which nobody can tell


@dataclass(frozen=True)
class TaskLevels:
    """What medium returned on one task, and the references that make a level of it.

    `medium` is unknown where none was collected.
    """

    task: str
    references: References
    medium: Reference

    @property
    def random(self) -> Reference:
        return self.references["random"]

    @property
    def expert(self) -> Reference:
        return self.references["expert"]

    @property
    def medium_error(self) -> float:
        return level_error(self.random, self.medium, self.expert)

    @property
    def medium_level(self) -> float:
        """Level of medium; NaN without all three."""
        return level(self.medium.mean, self.random.mean, self.expert.mean)

    @property
    def outside(self) -> float:
        """How far the level of medium lies outside MEDIUM_RANGE; 0 inside, and without medium."""
        (low, high), found = MEDIUM_RANGE, self.medium_level
        return 0.0 if np.isnan(found) else max(low - found, found - high, 0.0)

    def faults(self) -> list[str]:
        """What is wrong with the qualities of this task, one line each."""
        found = []
        random, medium, expert = self.random.mean, self.medium.mean, self.expert.mean
        if random >= expert:
            found.append(f"expert {expert:.1f} is not above random {random:.1f}")
        elif medium <= random or medium >= expert:
            found.append(
                f"medium {medium:.1f} is not between random {random:.1f} and expert {expert:.1f}"
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
            f"medium {self.medium.mean:.1f} has level {self.medium_level:.3f} +- "
            f"{self.medium_error:.3f} (random {self.random.mean:.1f}, "
            f"expert {self.expert.mean:.1f}), "
            f"outside [{low}, {high}]"
        )


def measure_levels(plan: Plan, reports: Iterable[BlockReport]) -> dict[str, TaskLevels]:
    """Medium and references per task name, in the plan's task order.

    Reports may come in any order: sums of floats depend on theirs, so blocks are put in the
    plan's first and the references in the file do not tell who finished when.
    """
    returns: dict[tuple[str, str], list[float]] = {}
    place = {block: number for number, block in enumerate(plan.blocks)}
    for report in sorted(reports, key=lambda report: place[report.block]):
        if report.block.kind != "tta":
            key = (report.block.task.name, report.block.name)
            returns.setdefault(key, []).extend(report.returns.tolist())

    def collected(task: str, name: str) -> Reference:
        return Reference.of(np.array(returns.get((task, name), [])))

    found: dict[str, dict[str, Reference]] = {}
    for task in plan.tasks:
        own = {name: collected(task.name, name) for name in ("zero", "random", "expert")}
        known = plan.on_record(task).by_name
        found[task.name] = {name: known.get(name, reference) for name, reference in own.items()}
    return {
        task: TaskLevels(task, references, collected(task, "medium"))
        for task, references in _with_constant(plan, found).items()
    }


def _with_constant(
    plan: Plan, found: Mapping[str, Mapping[str, Reference]]
) -> dict[str, References]:
    """The references of every task with the best constant action, where it can be chosen.

    It needs the candidates' returns on record: nobody acts constantly in a collection.
    """
    plain = {task: References(by_name) for task, by_name in found.items()}
    records = {task.name: plan.on_record(task).constants for task in plan.tasks}
    training = [task.name for task in plan.tasks if task.role in ("train", "both")]
    if not all(records.values()):
        return plain
    number = choose_constant(
        np.array([[candidate.mean for candidate in records[task]] for task in training]),
        np.array([found[task]["random"].mean for task in training]),
        np.array([found[task]["expert"].mean for task in training]),
    )
    if number is None:
        return plain
    action = tuple(constant_actions(plan.family.action_size)[number].tolist())
    return {
        task: References({**by_name, "constant": records[task][number]}, action)
        for task, by_name in found.items()
    }


def level_error(random: Reference, medium: Reference, expert: Reference) -> float:
    """Standard error of the level of medium.

    To first order, with S = expert - random and var() that of a mean:
    var(level) = (var(medium) + (1 - level)^2 var(random) + level^2 var(expert)) / S^2.
    Infinite with fewer than two episodes of any of them, or without a scale.
    """
    found = level(medium.mean, random.mean, expert.mean)
    errors = np.array([medium.error, random.error, expert.error])
    if not np.isfinite([found, *errors]).all():
        return float("inf")
    weights = np.array([1.0, 1 - found, found])
    return float(np.sqrt(((weights * errors) ** 2).sum()) / (expert.mean - random.mean))


def check_levels(plan: Plan, levels: dict[str, TaskLevels], parts: str) -> list[str]:
    """Refuse data whose qualities are not in order.

    Returns: warnings, of levels that lie outside their band by no more than their error; of a
    smoke version, whose few episodes decide nothing, one for all complaints.

    Raises: DataError naming every task concerned and its returns.
    """
    faults = [fault for task in levels.values() for fault in task.faults()]
    doubts = [doubt for task in levels.values() for doubt in task.doubts()]
    if "smoke" in plan.spec.version:
        return _summed(faults + doubts, len(levels))
    if not faults:
        return doubts
    raise DataError(
        Lines.of("the qualities are not in order, so nothing was written", *faults),
        where=plan.spec.name,
        hint=f"{_remedy(plan, levels)}; the parts are kept in {parts}",
    )


def _summed(complaints: list[str], num_tasks: int) -> list[str]:
    """A line for all of them: there is one for nearly every task, and none decides anything."""
    if len(complaints) < 2:
        return complaints
    return [
        f"qualities of {len(complaints)} of {num_tasks} tasks are not in order, which a few "
        f"episodes cannot tell; first {complaints[0]}"
    ]


def _remedy(plan: Plan, levels: Mapping[str, TaskLevels]) -> str:
    name, behaviour = plan.spec.name, plan.spec.behaviour
    if all(t.random.mean >= t.expert.mean for t in levels.values() if t.faults()):
        counts = plan.spec.episodes
        return (
            f"more episodes tell random and expert apart, if one is better: episodes of {name} in "
            f"datasets.yaml (now random {counts.random}, expert {counts.expert}, and "
            f"{plan.spec.reference} where there are none)"
        )
    if behaviour.network is None:
        return (
            f"mpdt-data calibrate {quoted(name)} measures the mixing rates again, into this "
            "folder; collect then makes only the blocks of new rates again"
        )
    return (
        f"change behaviour.rungs (now {behaviour.rungs}; medium is the rung nearest level 0.5) "
        f"or behaviour.noise of {name} in datasets.yaml, or leave medium out of it"
    )
