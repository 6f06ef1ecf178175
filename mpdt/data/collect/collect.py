"""Collect: where sim meets store. From a job to a finished file, resumable at every block.

job -> lock -> missing blocks on workers -> levels -> pack -> parts deleted
          |              |                              |
          |              '- parts survive any kill      '- qualities out of order, a false
          '- nothing to do? file is complete               version, other content than
                                                           locked: nothing is written
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mpdt.data.collect.engine import Engine, Processes, decisive_versions
from mpdt.data.collect.job import Job
from mpdt.data.collect.levels import check_levels, measure_levels
from mpdt.data.collect.pack import header_of, pack
from mpdt.data.collect.parts import PartsFolder
from mpdt.data.collect.plan import Block, Plan
from mpdt.data.collect.runner import BlockReport, Gap, report_part
from mpdt.data.lock.keeper import LockKeeper, plain_spec
from mpdt.data.spec.change import changed_keys
from mpdt.data.spec.entry import spec_hash
from mpdt.data.spec.family import decisive, own_definition
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset
from mpdt.disk import expect_folder, expect_room
from mpdt.errors import DataError, FormatError


@dataclass(frozen=True)
class Progress:
    """Where a collection stands. `steps` are env steps, counted at the full horizon."""

    num_blocks: int
    num_steps: int
    done_blocks: int
    done_steps: int
    resumed_blocks: int  # done by an earlier run
    resumed_steps: int
    damaged_blocks: int  # parts of an earlier run that are done again
    outdated_blocks: int  # whole ones, but of other mixing rates or weights; done again too
    last: Block | None  # the block that just finished


OnProgress = Callable[[Progress], None]


@dataclass(frozen=True)
class Collected:
    """Result of `collect`: the open file, and what was done for it.

    `lock` is one line on what the lock file holds of it now, or nothing.
    """

    dataset: Dataset
    is_new: bool
    resumed_blocks: int = 0
    warnings: list[str] = field(default_factory=list)
    lock: str = ""


def collect(
    job: Job,
    target: Path,
    *,
    workers: int | None = None,
    engine: Engine | None = None,
    restart: bool = False,
    lock: LockKeeper | None = None,
    on_progress: OnProgress | None = None,
) -> Collected:
    """Make the file of `job` at `target`, or go on with an interrupted collection.

    The content depends on its spec, the package versions, the CPU type and the behaviour
    weights only: not on the engine, interruptions or order.

    Args:
        workers: processes; None = one per core, 0 = in this process, with the BLAS kernel that
            its numpy has: see `pin_kernel`.
        engine: somebody else who does the blocks, such as a Ray cluster.
        restart: ignore and delete what an earlier run left, and replace a finished file.
        lock: the lock file to compare with and to write to; None = there is none.
        on_progress: called once at the start and after every block.

    Raises: DataError if the file or its unfinished parts belong to another spec, if the
        qualities are not in order, or if the lock holds something else; BusyError if another
        collector holds the target; StorageError; SpecError; SimulatorError. Finished blocks
        are kept in every case.
    """
    engine = engine or Processes(workers)
    if lock is None:
        return _collect(job, target, engine, restart, None, on_progress)
    lock.before(job.spec)
    done = _collect(job, target, engine, restart, lock.approve, on_progress)
    if not done.is_new:
        lock.approve(done.dataset)
    note, warnings = lock.after(done.dataset)
    return replace(done, lock=note, warnings=[*done.warnings, *warnings])


def _collect(
    job: Job,
    target: Path,
    engine: Engine,
    restart: bool,
    approve: Callable[[Dataset], None] | None,
    on_progress: OnProgress | None,
) -> Collected:
    plan, folder = job.plan, PartsFolder(target)
    if not restart and (finished := find_finished(job, target)):
        folder.forget(describe_plan(plan))
        return Collected(finished, is_new=False)
    check_space(plan, target)
    with folder.locked(), folder.kept_if_worth():
        if restart:
            folder.clear()
        elif finished := find_finished(job, target):  # by another collector, meanwhile
            folder.delete()
            return Collected(finished, is_new=False)
        folder.agree(describe_plan(plan))
        reports, resumed = run_missing(job, folder, engine, on_progress or (lambda _: None))
        levels = measure_levels(plan, reports)
        warnings = check_levels(plan, levels, str(folder.path))
        references = {task: level.references for task, level in levels.items()}
        dataset = pack(plan, folder, reports, header_of(job), references, approve)
        folder.delete()
    return Collected(dataset, True, resumed, warnings)


def find_finished(job: Job, target: Path) -> Dataset | None:
    """The finished file at `target` if this very spec and its policies made it, else None.

    Raises: DataError if something else is there, naming the keys of the spec that differ.
    """
    if not target.exists():
        return None
    try:
        dataset = open_dataset(target)
    except FormatError as error:
        raise DataError(
            f"the target exists, but {error.what}",
            where=str(target),
            hint="--restart replaces it, -o chooses another file",
        ) from error
    if dataset.parent:
        raise DataError(
            "the target exists and was cut out of another file",
            where=str(target),
            hint="choose another file with -o; --restart replaces it",
        )
    told = own_definition(job.plan.family)
    if told and (differ := changed_keys(decisive(dataset.definition), decisive(told))):
        raise DataError(
            f"the target was made of another definition of {dataset.family}: "
            + "; ".join(differ[:4])
            + (f"; and {len(differ) - 4} more" if differ[4:] else ""),
            where=str(target),
            hint="--restart makes it again from this one; -o writes another file",
        )
    if not (changed := changed_keys(dict(dataset.spec), plain_spec(job.spec))):
        if {policy.hash for policy in job.policies} == {p.hash for p in dataset.policy_infos()}:
            return dataset
        raise DataError(
            "the target was made with other behaviour weights or mixing rates",
            where=str(target),
            hint="--restart makes it again with those installed; -o writes another file",
        )
    raise DataError(
        "the target was made from another spec: " + "; ".join(changed),
        where=str(target),
        hint="--restart makes it again from the new spec; -o writes another file",
    )


def describe_plan(plan: Plan) -> dict[str, Any]:
    """Content of plan.json: what decides the bytes of the parts, but for who acts in them."""
    # Neither decides a byte of a part, and a version that claimed too much can be raised.
    spec = {k: v for k, v in plain_spec(plan.spec).items() if k not in ("version", "license")}
    told = own_definition(plan.family)
    return {
        "spec": spec,
        "spec_hash": spec_hash(spec),
        **({"definition": decisive(told)} if told else {}),
        "versions": decisive_versions(),
        # Which references are on record may change between two runs, and changes no part.
        "blocks": [block.label for block in plan.blocks if block.kind != "reference"],
    }


def check_space(plan: Plan, target: Path, option: str = "-o") -> None:
    """Refuse to start what cannot end: parts and file together must fit on the disk.

    Args: option: that chooses another place; "" = there is none.
    Raises: StorageError.
    """
    expect_folder(target.parent)
    needed = 2 * plan.file_bytes
    parts = PartsFolder(target).path / "blocks"
    if parts.is_dir():
        needed -= sum(part.stat().st_size for part in parts.glob("*.npz"))
    expect_room(target, needed, "the parts and the file", option)


def run_missing(
    job: Job, folder: PartsFolder, engine: Engine, on_progress: OnProgress
) -> tuple[list[BlockReport], int]:
    """Reports of all blocks, and how many of them an earlier run had finished."""
    reports: list[BlockReport] = []
    missing: list[Block] = []
    gaps: Counter[Gap] = Counter()
    plan = job.plan
    for block in plan.blocks:
        found = report_part(folder, block, job.actor(block))
        if isinstance(found, BlockReport):
            reports.append(found)
        else:
            gaps[found] += 1
            missing.append(block)
    resumed, resumed_steps = len(reports), sum(report.block.steps for report in reports)

    def tell(last: Block | None) -> None:
        on_progress(
            Progress(
                num_blocks=len(plan.blocks),
                num_steps=plan.num_steps,
                done_blocks=len(reports),
                done_steps=sum(report.block.steps for report in reports),
                resumed_blocks=resumed,
                resumed_steps=resumed_steps,
                damaged_blocks=gaps[Gap.DAMAGED],
                outdated_blocks=gaps[Gap.OUTDATED],
                last=last,
            )
        )

    tell(None)
    # Closed at once on an interrupt: no worker writes a part after its lock is gone.
    with closing(engine.reports(job, folder, missing)) as results:
        for report in results:
            reports.append(report)
            tell(report.block)
    return reports, resumed
