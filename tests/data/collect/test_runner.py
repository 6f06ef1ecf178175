"""Blocks that a worker steps side by side, and what they leave behind."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from mpdt.data.collect.job import make_job
from mpdt.data.collect.parts import PartsFolder
from mpdt.data.collect.plan import Block, Plan, make_plan
from mpdt.data.collect.runner import BlockRunner, bundled
from mpdt.data.spec.entry import Behaviour, DatasetSpec, EpisodeCounts, TtaRule
from tests.data.collect.test_plan import make_spec


def meta_world(**changes: object) -> DatasetSpec:
    own = {"family": "ml10", "tasks": ("reach", "push"), "behaviour": Behaviour(script="metaworld")}
    return make_spec(**(own | changes))


def sizes(plan: Plan, workers: int) -> list[int]:
    """Blocks per bundle; whatever the bundles, they are the plan's blocks in their order."""
    bundles = bundled(plan, plan.blocks, workers)
    assert tuple(block for some in bundles for block in some) == plan.blocks
    for some in bundles:
        assert len({(block.task, block.horizon) for block in some}) == 1
    return [len(some) for some in bundles]


def test_blocks_of_a_task_and_horizon_are_bundled_as_the_workers_allow() -> None:
    """Of each task 4 random, 2 expert, 1 short one and 1 zero block of four rows: 64 rows."""
    plan = make_plan(
        meta_world(
            block=4,
            episodes=EpisodeCounts(random=16, expert=8),
            tta={"short": TtaRule(episodes=4, horizon=3, tasks="all")},
            reference=4,
        )
    )
    assert sizes(plan, 1) == sizes(plan, 0) == [4, 2, 1, 1] * 2  # 16 rows: a quarter of 64
    assert sizes(plan, 2) == [2, 2, 2, 1, 1] * 2
    assert sizes(plan, 50) == [1] * 16
    networks = make_plan(make_spec(episodes=EpisodeCounts(random=16)))
    assert set(sizes(networks, 1)) == {1}, "rows of locomotion are blocks of their own"
    rolled_out = replace(plan, side_by_side=4)
    assert set(sizes(rolled_out, 1)) == {1}, "one policy acts in all of them"


def test_blocks_side_by_side_leave_the_parts_of_blocks_one_by_one(tmp_path: Path) -> None:
    """Uniform actions, two blocks of the script and one that is shorter."""
    counts = EpisodeCounts(random=2, expert=3)
    job = make_job(meta_world(block=2, horizon=5, episodes=counts, tasks=("reach",)))
    blocks = job.plan.of_kind("episodes")
    assert [(block.name, block.rows) for block in blocks] == [
        ("random", 2), ("expert", 2), ("expert", 1)
    ]  # fmt: skip
    folders = []
    for name in ("together", "alone"):
        folder = PartsFolder(tmp_path / name)
        (folder.path / "blocks").mkdir(parents=True)
        folders.append(folder)
    reports = BlockRunner(job, folders[0]).together(blocks)
    alone = BlockRunner(job, folders[1])
    for block, report in zip(blocks, reports, strict=True):
        single = alone(block)
        assert report.block is block and report.steps == single.steps
        np.testing.assert_array_equal(report.returns, single.returns)
        assert part_of(folders[0], block) == part_of(folders[1], block)


def part_of(folder: PartsFolder, block: Block) -> bytes:
    return folder.part(block).path.read_bytes()
