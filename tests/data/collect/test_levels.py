"""Levels by hand: random 10, expert 110, so medium 60 has level 0.5."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mpdt.data.collect.levels import TaskLevels, level_error, measure_levels
from mpdt.data.collect.plan import Plan, make_plan
from mpdt.data.collect.runner import BlockReport
from mpdt.data.reference import Reference, References
from mpdt.data.sim.record import Record
from mpdt.data.spec.catalog import load_catalog

NAN = float("nan")


def levels(random: float, medium: float, expert: float, error: float = 0.0) -> TaskLevels:
    """`error` is that of the level; with exact references medium carries all of it."""
    ends = References({"random": Reference(random, 0.0), "expert": Reference(expert, 0.0)})
    return TaskLevels("t", ends, Reference(medium, error * (expert - random)))


def test_level_of_medium() -> None:
    assert levels(10, 60, 110).medium_level == 0.5
    assert levels(-100, -50, 300).medium_level == 0.125
    assert math.isnan(levels(5, 5, 5).medium_level)


@pytest.mark.parametrize(
    ("returns", "text"),
    [
        ((10, 60, 110), ""),
        ((10, 45, 110), ""),  # level 0.35, the edge
        ((10, 75, 110), ""),  # level 0.65, the edge
        ((10, 44, 110), "level 0.340 +- 0.000"),
        ((10, 76, 110), "level 0.660 +- 0.000"),
        ((10, 120, 110), "not between random 10.0 and expert 110.0"),
        ((10, 5, 110), "not between"),
        ((10, 10, 110), "not between"),
        ((10, 60, 10), "expert 10.0 is not above random 10.0"),
        ((10, NAN, 110), ""),  # no medium asked for
        ((10, NAN, 9), "not above"),
    ],
)
def test_faults(returns: tuple[float, float, float], text: str) -> None:
    found = levels(*returns).faults()
    assert (text in found[0] and found[0].startswith("t: ")) if text else found == []


@pytest.mark.parametrize(
    ("medium", "error", "is_fault", "is_doubt"),
    [
        (44, 0.004, True, False),  # level 0.34: 0.01 outside is more than twice 0.004
        (44, 0.006, False, True),
        (76, 0.004, True, False),
        (76, 0.006, False, True),
        (44, math.inf, False, True),  # one episode of a quality tells nothing
        (60, math.inf, False, False),
        (5, math.inf, True, False),  # the order is a matter of the data as they are
    ],
)
def test_a_level_counts_as_far_as_it_is_known(
    medium: float, error: float, is_fault: bool, is_doubt: bool
) -> None:
    found = levels(10, medium, 110, error)
    assert (bool(found.faults()), bool(found.doubts())) == (is_fault, is_doubt)
    for line in found.doubts():
        assert line.startswith(f"t: medium {medium:.1f} has level {found.medium_level:.3f} +- ")
        assert f"{error:.3f}" in line and "within 2 standard errors" in line


def test_error_of_a_level_by_hand() -> None:
    """random 0 +- 2, medium 25 +- 3, expert 100 +- 4 (errors of the mean): level 0.25.

    0.01 * sqrt(3^2 + (0.75 * 2)^2 + (0.25 * 4)^2) = 0.01 * sqrt(12.25) = 0.035
    """

    random, medium, expert = Reference(0, 2), Reference(25, 3), Reference(100, 4)
    assert level_error(random, medium, expert) == pytest.approx(0.035)
    assert level_error(random, medium, Reference(100, NAN)) == math.inf
    assert level_error(random, Reference(), expert) == math.inf
    assert level_error(random, medium, random) == math.inf


def test_error_of_a_level_is_that_of_many_draws() -> None:
    """The slow twin: the spread of the level over repeated data sets."""
    rng = np.random.default_rng(0)
    sets = [[rng.normal(mean, 20.0, 50) for mean in (10.0, 40.0, 110.0)] for _ in range(2000)]
    seen = [levels(*(float(returns.mean()) for returns in one)).medium_level for one in sets]
    told = np.mean([level_error(*map(Reference.of, one)) for one in sets])
    assert told == pytest.approx(np.std(seen), rel=0.06)


def test_the_order_of_arrival_changes_no_bit() -> None:
    """0.1 + 0.2 + 0.3 is not 0.3 + 0.2 + 0.1: references must not tell who finished when."""
    plan = make_plan(load_catalog().get("cheetah_dir"))
    draws = np.random.Generator(np.random.PCG64(0))
    reports = [BlockReport(b, b.steps, 1e3 * draws.normal(size=b.rows)) for b in plan.blocks]
    wanted = measure_levels(plan, reports)
    for _ in range(5):
        shuffled = [reports[i] for i in draws.permutation(len(reports))]
        assert repr(measure_levels(plan, shuffled)) == repr(wanted)


def report(plan: Plan, task: int, name: str, *returns: float) -> BlockReport:
    chosen = [b for b in plan.blocks if (b.task.index, b.name, b.number) == (task, name, 0)]
    return BlockReport(chosen[0], 0, np.array(returns))


def record(zero: float, up: float, **by_name: float) -> Record:
    """zero, and +1 along axis 2 as the only candidate that does something."""
    table = [Reference(up if i == 3 else zero, 0.1, 20, source="shipped") for i in range(13)]
    known = {"zero": zero, **by_name}
    return Record(
        {name: Reference(mean, 0.1, 20, source="shipped") for name, mean in known.items()},
        tuple(table),
    )


def test_the_record_wins_over_the_episodes_of_the_collection() -> None:
    """forward: all on record. backward: another expert acts, so its episodes count instead."""
    spec = load_catalog().get("cheetah_dir")
    records = {
        "forward": record(1.0, 41.0, random=0.0, expert=100.0),
        "backward": record(0.0, 10.0, random=0.0),
    }
    plan = make_plan(spec, records)
    given = {"random": (-5.0, 5.5), "medium": (48.0, 52.0), "expert": (190.0, 210.0)}
    found = measure_levels(
        plan, [report(plan, task, *one) for task in (0, 1) for one in
               [(name, *returns) for name, returns in given.items()]],
    )  # fmt: skip
    forward, backward = found["forward"], found["backward"]
    assert (forward.random.mean, forward.expert.mean) == (0.0, 100.0)
    assert forward.medium_level == 0.5 and forward.medium.episodes == 2
    assert (backward.random.mean, backward.expert.mean) == (0.0, 200.0)
    assert (backward.expert.source, backward.random.source) == ("collected", "shipped")
    assert (backward.expert.episodes, backward.expert.error) == (2, 10.0)
    # Levels of the candidate: 41 / 100 and 10 / 200, mean 0.23; all others 0.005.
    for task in (forward, backward):
        assert task.references.constant_action == (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    assert forward.references["constant"].mean == 41.0
    assert backward.references["constant"].mean == 10.0


def test_the_constant_is_chosen_on_training_tasks() -> None:
    """A test task that would love another action has no say; without a table nobody has."""
    spec = load_catalog().get("cheetah_dir")
    plan = make_plan(spec, {
        "forward": record(0.0, 5.0, random=0.0, expert=100.0),
        "backward": record(0.0, -90.0, random=0.0, expert=100.0),
    })  # fmt: skip

    def action(plan: Plan) -> tuple[float, ...]:
        return measure_levels(plan, [])["backward"].references.constant_action

    assert action(plan) == (0.0,) * 6  # zero: -42.5 is worse
    tasks = (replace(plan.tasks[0], role="train"), replace(plan.tasks[1], role="test"))
    assert action(replace(plan, tasks=tasks)) == (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    tasks = tuple(replace(task, role="test") for task in tasks)
    assert action(replace(plan, tasks=tasks)) == ()
    unknown = Record(plan.records["backward"].by_name)
    some = replace(plan, records={**plan.records, "backward": unknown})
    assert (
        action(some) == ()
        and not measure_levels(some, [])["forward"].references["constant"].is_known
    )
