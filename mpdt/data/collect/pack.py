"""Pack: parts -> one file, in canonical order, with slices, statistics and references.

Some blocks at a time are opened, so memory does not grow with the file. The old file at
the target stays until the new one has been read back and compared with the parts' digests.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import msgspec

from mpdt.data.collect.job import Job
from mpdt.data.collect.parts import PartsFolder
from mpdt.data.collect.plan import Block, Plan
from mpdt.data.collect.runner import BlockReport
from mpdt.data.episode import Episode
from mpdt.data.reference import References
from mpdt.data.slices.standard import standard_additions
from mpdt.data.spec.env import describe_env
from mpdt.data.spec.family import own_definition
from mpdt.data.store import provenance
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.sources import EpisodeSource, FileHeader, TtaSource
from mpdt.data.store.tables import Additions, TaskRow
from mpdt.data.store.writer import write_file
from mpdt.data.workers.threads import in_order


def pack(
    plan: Plan,
    folder: PartsFolder,
    reports: Sequence[BlockReport],
    header: FileHeader,
    references: Mapping[str, References],
    approve: Callable[[Dataset], None] | None = None,
) -> Dataset:
    """Write the target of `folder` from the parts of all blocks of `plan`.

    Args:
        reports: one per block, in any order.
        header: with every policy an episode may name; see `header_of`.
        references: by task name, for the task table.
        approve: looks at all episodes before the file takes its place; may raise.

    Raises: StorageError where the disk refuses, DataError for a part that was damaged
        meanwhile; the target is untouched in both cases.
    """
    steps = {report.block: report.steps for report in reports}

    def counts(blocks: Sequence[Block]) -> tuple[int, int]:
        return sum(block.rows for block in blocks), sum(steps[block] for block in blocks)

    def episodes(blocks: Sequence[Block]) -> Iterator[Episode]:
        # The next parts are read and proven while this one is written.
        for loaded in in_order(lambda block: folder.part(block).load_episodes(), blocks):
            yield from loaded

    stored = plan.of_kind("episodes")
    tta: dict[str, TtaSource] = {}
    for name in sorted(plan.spec.tta):
        if blocks := plan.of_kind("tta", name):
            tta[name] = tta_source(plan, name, episodes(blocks), *counts(blocks))
    source = EpisodeSource(episodes(stored), *counts(stored))

    def finish(dataset: Dataset) -> Additions:
        if approve is not None:
            approve(dataset)
        return replace(standard_additions(dataset), references=references)

    return write_file(folder.target, header, source, tta, finish)


def tta_source(
    plan: Plan, name: str, episodes: Iterable[Episode], num_episodes: int, num_steps: int
) -> TtaSource:
    """One set as the writer takes it: its episodes, and what the spec says of them."""
    return TtaSource(
        episodes, num_episodes, num_steps, _preset_returns(plan, name), _rule(plan, name)
    )


def header_of(job: Job) -> FileHeader:
    """What a file made by this job says of itself."""
    plan = job.plan
    spec, family = plan.spec, plan.family
    packages, plain = provenance.packages(), msgspec.to_builtins(spec)
    told_of = own_definition(family)
    if job.ladder is not None and job.ladder.weights:  # the spec says where they lay
        packages[provenance.WEIGHTS] = job.ladder.weights
    return FileHeader(
        family=family.name,
        name=spec.name,
        version=spec.version,
        license=spec.license,
        spec=plain,
        observation_size=family.observation_size,
        action_size=family.action_size,
        has_success=family.has_success,
        tasks=[
            TaskRow(
                task.name,
                task.index,
                task.role,
                describe_env(plain, spec.family, task.name, told_of),
            )
            for task in plan.tasks
        ],
        policies=job.policies,
        packages=packages,
        definition=told_of,
    )


def _preset_returns(plan: Plan, name: str) -> dict[int, float]:
    wanted = plan.spec.tta[name].preset_return
    # `auto` is fixed per family: a value out of the data would have looked at the test task.
    value = plan.family.return_target if wanted == "auto" else wanted
    return {block.task.index: float(value) for block in plan.of_kind("tta", name)}


def _rule(plan: Plan, name: str) -> dict[str, Any]:
    rule, family = plan.spec.tta[name], plan.family
    return {
        "low": family.action_low,
        "high": family.action_high,
        "action_scale": rule.action_scale,
        "horizon": rule.horizon or plan.spec.horizon,
    }
