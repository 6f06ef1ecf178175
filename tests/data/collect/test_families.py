"""All seven families: shipped behaviour is in order, small files do not depend on workers."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.sim.calibration import load_calibrations
from mpdt.data.sim.ladder import load_ladder
from mpdt.data.sim.network_file import network_files
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.spec.entry import DatasetSpec, EpisodeCounts, TtaRule
from mpdt.data.spec.goals import GoalSet
from mpdt.data.store.reader import open_dataset

CATALOG = load_catalog(Path(__file__).parents[3] / "datasets.yaml")
LOCOMOTION = ("cheetah_dir", "cheetah_vel", "ant_dir")
METAWORLD = ("ml10", "ml45", "mt10", "mt50")
BAND = (0.35, 0.65)


@pytest.mark.parametrize("name", LOCOMOTION)
def test_shipped_networks_put_random_below_medium_below_expert(name: str) -> None:
    """By the returns measured when the rungs were chosen; `verify` measures them in a file."""
    record = json.loads(network_files(name)[1].read_text())
    spec = CATALOG.get(name)
    ladder = load_ladder(spec)
    for task in spec.resolve_tasks():
        policy, _ = ladder.policy(task, "medium", 0)
        assert BAND[0] <= policy.info.level <= BAND[1], task.name
        by_step = {rung["train_step"]: rung["returns"][task.name] for rung in record["rungs"]}
        medium, final = by_step[policy.info.train_step], record["rungs"][-1]["returns"][task.name]
        assert record["random"][task.name] < medium < final, task.name


@pytest.mark.parametrize("name", [*METAWORLD, *(f"{name}_h200" for name in METAWORLD)])
def test_shipped_calibrations_put_random_below_medium_below_expert(name: str) -> None:
    shipped, spec = load_calibrations(Path("/nowhere")), CATALOG.get(name)
    for task in spec.resolve_tasks():
        found = shipped[task.name, spec.horizon]
        assert BAND[0] <= found.level <= BAND[1], task.name
        levels = (found.random, found.medium, found.expert)
        returns = [measured.mean_return for measured in levels]
        assert returns == sorted(returns) and len(set(returns)) == 3, task.name
        level = (returns[1] - returns[0]) / (returns[2] - returns[0])
        # Four levels were scaled by fewer episodes than their ends rest on.
        assert level == pytest.approx(found.level, abs=0.02), task.name


@pytest.mark.parametrize(
    ("name", "expected"),
    [("cheetah_vel", -22.0), ("ant_dir", 420.0)],
)
def test_test_tasks_have_an_expert(name: str, expected: float) -> None:
    """The behaviour network knows the tasks that a learner is tested on."""
    final = json.loads(network_files(name)[1].read_text())["rungs"][-1]["returns"]
    tasks = CATALOG.get(name).resolve_tasks()
    assert np.mean([final[task.name] for task in tasks if task.role == "test"]) >= expected


def small(name: str) -> DatasetSpec:
    """The shortest calibrated horizon, a handful of episodes of every kind, two tasks.

    One of Meta-World, a different one per family: most of the time is MuJoCo reading the arm.
    """
    spec = CATALOG.get(name)
    tasks = [task.index for task in spec.resolve_tasks()]
    place = METAWORLD.index(name) if name in METAWORLD else 0
    counts = EpisodeCounts(random=1, expert=2)
    if name in LOCOMOTION:
        counts = EpisodeCounts(random=2, medium=2, expert=2, history=2)
    return msgspec.structs.replace(
        spec, tasks=tuple(tasks[:2] if name in LOCOMOTION else tasks[place : place + 1]),
        horizon=200, block=2, reference=1, episodes=counts,
        tta={"default": TtaRule(episodes=2, tasks="all", horizon=10)},
    )  # fmt: skip


# Of two families that differ in their tasks alone one is slow.
ALIKE = ("cheetah_vel", "ml45", "mt10")


@pytest.mark.long
@pytest.mark.parametrize("name", [
    pytest.param(name, marks=pytest.mark.slow) if name in ALIKE else name
    for name in LOCOMOTION + METAWORLD
])  # fmt: skip
def test_one_and_two_workers_make_the_same_file(name: str, tmp_path: Path) -> None:
    found = set()
    for workers in (1, 2):
        target = tmp_path / f"{workers}.h5"
        data = collect(make_job(small(name)), target, workers=workers).dataset
        found.add((data.content_hash, data.tta["default"].content_hash))
    assert len(found) == 1
    if CATALOG.get(name).goals is not None:
        check_goals(tmp_path / "1.h5", GoalSet(count=50, held_out=5))


def check_goals(path: Path, goals: GoalSet) -> None:
    """Qualities share the training goals; adaptation meets only held-out ones."""
    data = open_dataset(path)
    for row in range(len(data.tasks)):
        by_quality = [
            [tuple(data.episode(int(i)).goal) for i in data.select(task=row, quality=quality)]
            for quality in ("random", "expert")
        ]
        assert by_quality[0][0] == by_quality[1][0]
        assert len(set(by_quality[1])) == 2
        tta = data.tta["default"]
        held_out = {tuple(data.goals.of(int(g))) for g in tta.goal[tta.task == row]}
        assert len(held_out) == min(2, goals.held_out)
        assert not held_out & set(by_quality[1])
