"""Roll-outs: episodes of a policy as an ordinary file, made by what makes collections.

    origin + who acts -> blocks of quality `policy` -> workers -> parts -> levels -> file

Seeds: the data's root seed, quality POLICY, block (series + 1) * HISTORY_STRIDE + n, row. So the
file can be merged with its data and with roll-outs of other series, and another policy of the same
series begins where this one began. The first stride belongs to evaluations that were kept.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mpdt.data.collect.collect import OnProgress, check_space, describe_plan, run_missing
from mpdt.data.collect.engine import Processes
from mpdt.data.collect.job import Job
from mpdt.data.collect.origin import Acted, Origin, header_of_policy
from mpdt.data.collect.pack import pack
from mpdt.data.collect.parts import PartsFolder
from mpdt.data.collect.plan import Block, Plan, cut
from mpdt.data.collect.runner import BlockReport
from mpdt.data.reference import level
from mpdt.data.sim.ladder import Ladder
from mpdt.data.spec.entry import MOST
from mpdt.data.spec.tasks import get_family
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset
from mpdt.data.store.sources import FileHeader
from mpdt.data.store.tables import TaskRow
from mpdt.disk import check_replaceable
from mpdt.errors import DataError, FormatError, UsageError, quoted
from mpdt.seeding import HISTORY_STRIDE, Quality

VERB = "rollout"
NAME = "policy"
"""Of the quality."""
MOST_SERIES = 65_000


@dataclass(frozen=True, eq=False)
class RollOuts:
    """What is asked for.

    Args:
        actor: answers with the policy for quality `policy`; pickled for workers.
        tasks: of the origin.
        unseen_goals: act on the held-out goals, where the data numbers its goals.
    """

    origin: Origin
    acted: Acted
    actor: Ladder
    tasks: tuple[TaskRow, ...]
    episodes: int
    series: int = 0
    unseen_goals: bool = False

    @property
    def rule(self) -> dict[str, Any]:
        """All that decides the file beside its data, as JSON values."""
        return {
            **self.acted.told,
            "tasks": [task.name for task in self.tasks],
            "episodes": self.episodes,
            "seed": self.series,
        } | ({"goals": "held out"} if self.unseen_goals else {})

    def job(self) -> Job:
        """The blocks. Raises: UsageError for numbers out of range; SpecError."""
        for option, value, least, most in (
            ("--episodes", self.episodes, 1, MOST["episodes"]),
            ("--seed", self.series, 0, MOST_SERIES),
        ):
            if not least <= value <= most:
                raise UsageError("out of range", where=option, found=f"{value:,}",
                                 expected=f"{least} to {most:,}")  # fmt: skip
        family = get_family(self.origin.family)
        spec = self.origin.collected_spec()
        first = (self.series + 1) * HISTORY_STRIDE
        tasks = tuple(replace(family.task(task.index), role=task.role) for task in self.tasks)
        blocks = tuple(
            Block("episodes", NAME, task, Quality.POLICY, first + number, rows, spec.horizon,
                  unseen_goals=self.unseen_goals)
            for task in tasks
            for number, rows in cut(self.episodes, spec.block)
        )  # fmt: skip
        width = min(family.policy_rows, spec.block)
        return Job(Plan(spec, family, tasks, blocks, side_by_side=width), self.actor)


@dataclass(frozen=True)
class Reached:
    """What the policy reached on a task, in these episodes."""

    task: str
    mean: float
    level: float


@dataclass(frozen=True)
class RolledOut:
    """The open file, and whether it was made now."""

    dataset: Dataset
    is_new: bool
    reached: tuple[Reached, ...]
    resumed_blocks: int = 0


def roll_out_to(
    asked: RollOuts,
    target: Path,
    *,
    workers: int | None = None,
    restart: bool = False,
    versions: Mapping[str, str] | None = None,
    on_progress: OnProgress | None = None,
) -> RolledOut:
    """Make the file of these roll-outs at `target`, or go on with what was interrupted.

    The same bytes for any number of workers and any interruption.

    Args:
        workers: processes; None = one per core, 0 = in this process.
        restart: ignore and delete what an earlier call left, and replace roll-outs.
        versions: of what the policy's numbers depend on beside simulators; parts never mix them.
    Raises: UsageError; DataError if something else is at `target` or its parts are of another
        call; BusyError; StorageError; SimulatorError; whatever the policy raises. Finished blocks
        are kept in every case.
    """
    job, folder = asked.job(), PartsFolder(target)
    check_replaceable(target)
    if finished := _finished(asked, target, restart):
        folder.forget(_told(asked, job, versions))
        return RolledOut(finished, False, _reached_in(finished))
    check_space(job.plan, target)
    with folder.locked():
        if restart:
            folder.clear()
        elif finished := _finished(asked, target):  # by another process, meanwhile
            folder.delete()
            return RolledOut(finished, False, _reached_in(finished))
        folder.agree(_told(asked, job, versions))
        reports, resumed = run_missing(
            job, folder, Processes(workers), on_progress or (lambda _: None)
        )
        reached = _reached(asked.tasks, reports)
        dataset = pack(job.plan, folder, reports, _header(asked, job, reached), {})
        folder.delete()
    return RolledOut(dataset, True, _reached_in(dataset), resumed)


def _told(asked: RollOuts, job: Job, versions: Mapping[str, str] | None) -> dict[str, Any]:
    """What finished blocks depend on."""
    plan = describe_plan(job.plan)
    told = {"rule": asked.rule, "from": asked.origin.content_hash}
    return plan | told | {"versions": plan["versions"] | dict(versions or {})}


def _header(asked: RollOuts, job: Job, reached: Mapping[int, Reached]) -> FileHeader:
    spec = msgspec.to_builtins(job.spec)
    same = {key: spec[key] for key in ("family", "horizon", "seed", "block", "env")}
    header = header_of_policy(
        asked.origin, asked.acted, VERB, asked.tasks,
        {index: one.level for index, one in reached.items()},
        episodes={NAME: asked.episodes}, **same,
    )  # fmt: skip
    return replace(header, lineage=[dict(header.lineage[0]) | {"rule": asked.rule}])


def _reached(tasks: Sequence[TaskRow], reports: Sequence[BlockReport]) -> dict[int, Reached]:
    """By family index. In the order of the blocks: sums of floats depend on theirs."""
    found = {}
    for task in tasks:
        own = sorted((r for r in reports if r.block.task.index == task.index),
                     key=lambda report: report.block.number)  # fmt: skip
        mean = float(np.concatenate([report.returns for report in own]).mean())
        found[task.index] = Reached(task.name, mean, level_on(task, mean))
    return found


def level_on(task: TaskRow, mean: float) -> float:
    """Level of a mean return; nan without both references."""
    return level(mean, task.references["random"].mean, task.references["expert"].mean)


def _reached_in(dataset: Dataset) -> tuple[Reached, ...]:
    names, table = dataset.tasks.names, dataset.policies
    levels = {int(row): float(x) for row, x in zip(table.tasks, table.levels, strict=True)}
    return tuple(
        Reached(name, float(dataset.episodes.returns[dataset.select(task=row)].mean()),
                levels.get(row, math.nan))
        for row, name in enumerate(names)
    )  # fmt: skip


def _finished(asked: RollOuts, target: Path, restart: bool = False) -> Dataset | None:
    """The file at `target` if this very call made it. Raises: DataError for anything else.

    Args:
        restart: any roll-outs may be there, and are to be replaced.
    """
    if not target.exists():
        return None
    try:
        dataset = open_dataset(target)
        last = dataset.lineage[-1] if dataset.lineage else {}
        found = f"made by {last.get('verb', 'collect or import')}"
        if last.get("verb") == VERB:
            if restart:
                return None
            if (last.get("rule"), last["from"]) == (asked.rule, [asked.origin.content_hash]):
                return dataset
            found = "roll-outs of another policy, of other data or by another rule"
    except FormatError as error:
        found = error.what
    raise DataError(
        "something else is there", where=str(target), found=found,
        hint=f"choose another name with -o, or move {quoted(target)} away first",
    )  # fmt: skip
