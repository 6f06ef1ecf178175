"""Add a set for test-time adaptation to a finished file.

    file -> its spec with one more rule -> job -> missing blocks on workers -> changed copy

The blocks are those of a collection, so a set added later is the set collected at once. An
interrupted addition goes on from the folder `FILE.tta-NAME.parts`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec
import numpy as np

from mpdt.data.collect.collect import OnProgress, check_space, describe_plan, run_missing
from mpdt.data.collect.engine import DECISIVE_PACKAGES, Processes
from mpdt.data.collect.job import Job
from mpdt.data.collect.pack import tta_source
from mpdt.data.collect.parts import PartsFolder
from mpdt.data.collect.plan import Block, Plan, make_plan
from mpdt.data.collect.standing import standing_spec
from mpdt.data.episode import Episode
from mpdt.data.spec.entry import EpisodeCounts, TtaRule
from mpdt.data.store import provenance
from mpdt.data.store.amend import add_tta
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.layout import checked_name
from mpdt.data.store.proof import check_digests
from mpdt.data.store.reader import open_dataset
from mpdt.disk import holding
from mpdt.errors import DataError, FormatError, UsageError


@dataclass(frozen=True)
class Added:
    """Result of `add_set`: the open file, and what to know about the set."""

    dataset: Dataset
    warnings: list[str] = field(default_factory=list)
    is_new: bool = True


def stored_rule(dataset: Dataset, name: str) -> TtaRule:
    """The rule of that name in the file's spec; the defaults where it has none.

    Raises: as `standing_spec`.
    """
    return standing_spec(dataset).tta.get(name) or TtaRule(episodes=20)


def set_job(dataset: Dataset, name: str, rule: TtaRule, tasks: Sequence[str] = ()) -> Job:
    """One set for `dataset`: its blocks as a collection would have planned them.

    Args:
        tasks: names of the only tasks to get one; empty = those that `rule.tasks` says.
    Raises: as `standing_spec`; SpecError for a rule that cannot be; UsageError
        for an unknown task, or where no task is left.
    """
    checked_name(name)
    chosen = {dataset.task_row(task) for task in tasks} or set(range(len(dataset.tasks)))
    indices = {dataset.tasks.indices[row] for row in chosen}
    # Nothing but the set: neither stored episodes nor references.
    spec = msgspec.structs.replace(
        standing_spec(dataset), tta={name: rule}, episodes=EpisodeCounts()
    )
    plan = make_plan(spec)
    blocks = tuple(b for b in plan.of_kind("tta", name) if b.task.index in indices)
    if not blocks:
        raise UsageError(f"no {rule.tasks} task in this file", where=str(dataset.path),
                         hint="--tasks all, or name some")  # fmt: skip
    return Job(replace(plan, blocks=blocks))


def add_set(
    dataset: Dataset,
    job: Job,
    *,
    workers: int | None = None,
    overwrite: bool = False,
    restart: bool = False,
    on_progress: OnProgress | None = None,
) -> Added:
    """Simulate a TTA set and put it into its file, whose episodes stay what they are.

    Args:
        dataset: the open file; the result is another view of it.
        job: of `set_job`.
        workers: processes; None = one per core, 0 = in this process.
        overwrite: a set of that name may be another one and is replaced.
        restart: delete what an interrupted addition left.
    Raises: UsageError if another set has that name; BusyError; StorageError;
        SimulatorError. The file is untouched by any of them.
    """
    path, plan, (name,) = dataset.path, job.plan, job.spec.tta
    source = tta_source(plan, name, (), plan.num_tta_episodes, 0)
    if "seed" not in dataset.spec:  # an import: nothing else in the file says it
        source = replace(source, rule={**source.rule, "seed": job.spec.seed})
    folder = PartsFolder(path.with_name(f"{path.name}.tta-{name}"))
    if name in dataset.tta and not overwrite:
        _check_same(dataset, name, plan, source.rule, source.preset_returns)
        if not restart and _is_whole(dataset, name):
            folder.forget(describe_plan(plan))
            return Added(dataset, _version_warnings(dataset), is_new=False)
    check_space(plan, folder.target, option="")
    with folder.locked():
        if restart:
            folder.clear()
        folder.agree(describe_plan(plan))
        reports, _ = run_missing(job, folder, Processes(workers), on_progress or (lambda _: None))
        steps = sum(report.steps for report in reports)
        episodes = _episodes(folder, plan.blocks)
        source = replace(source, episodes=episodes, num_steps=steps)
        with holding(path, amends=True):
            now = open_dataset(path)  # another process may have written it meanwhile
            if now.content_hash != dataset.content_hash:
                raise DataError("other episodes took their place meanwhile", where=str(path),
                                expected=f"content {dataset.content_hash[:16]}",
                                found=now.content_hash[:16],
                                hint="the same command again makes the set for them")  # fmt: skip
            if name in now.tta and not overwrite:
                _check_same(now, name, plan, source.rule, source.preset_returns)
            done = add_tta(path, name, source)
        folder.delete()
    return Added(done, _version_warnings(dataset))


def _is_whole(dataset: Dataset, name: str) -> bool:
    """Whether the set's own bytes have its digests; one that is damaged is made again."""
    try:
        check_digests(dataset, sets=[name], ids=np.zeros(0, np.int64))
    except FormatError:
        return False
    return True


def _episodes(folder: PartsFolder, blocks: Sequence[Block]) -> Iterator[Episode]:
    for block in blocks:
        yield from folder.part(block).load_episodes()


def _check_same(
    dataset: Dataset, name: str, plan: Plan, rule: Mapping[str, Any], presets: Mapping[int, float]
) -> None:
    """Raises: UsageError unless the set that is there is the one that is planned."""
    found, wanted, there = dataset.tta[name], Counter[int](), Counter[int]()
    for block in plan.blocks:
        wanted[block.task.index] += block.rows
    old: dict[int, float] = {}
    for row, preset in zip(found.task.tolist(), found.preset_return.tolist(), strict=True):
        task = dataset.tasks.indices[row]
        there[task] += 1
        old[task] = preset
    new = {task: float(np.float32(preset)) for task, preset in presets.items()}
    if (dict(found.rule), there, old) != (dict(rule), wanted, new):
        raise UsageError(f"the file has another set '{name}'", where=str(dataset.path),
                         found=f"{len(found)} episodes, {dict(found.rule)}",
                         hint="choose another --name, or replace it with --overwrite")  # fmt: skip


def _version_warnings(dataset: Dataset) -> list[str]:
    """The file says once which packages made it."""
    here = provenance.packages()
    return [
        f"made with {name} {here[name]}, the file's episodes with {dataset.packages[name]}"
        for name in DECISIVE_PACKAGES
        if name in here and dataset.packages.get(name, here[name]) != here[name]
    ]
