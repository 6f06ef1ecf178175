"""Plan: block counts worked out by hand, keys by position, order canonical."""

from __future__ import annotations

import msgspec
import pytest

from mpdt.data.collect.plan import Block, make_plan, spread
from mpdt.data.reference import Reference
from mpdt.data.sim.record import NOTHING, Record
from mpdt.data.spec.entry import Behaviour, DatasetSpec, EpisodeCounts, TtaRule
from mpdt.seeding import HISTORY_STRIDE, Quality


def make_spec(**changes: object) -> DatasetSpec:
    spec = DatasetSpec(
        name="tiny", version="1.0.0", family="cheetah_dir", horizon=10, seed=3, block=4,
        behaviour=Behaviour(network="x", rungs=3), license="MIT", reference=5,
        episodes=EpisodeCounts(random=6, expert=4), tta={"default": TtaRule(episodes=2)},
    )  # fmt: skip
    return msgspec.structs.replace(spec, **changes)


def labels(spec: DatasetSpec) -> list[tuple[str, int]]:
    return [(block.label, block.rows) for block in make_plan(spec).blocks]


def test_blocks_of_one_task_by_hand() -> None:
    """6 random in blocks of 4 = 4 + 2; 4 expert = 4; 2 tta; 5 zero-action = 4 + 1."""
    assert labels(make_spec(tasks=("forward",))) == [
        ("forward-random-0", 4),
        ("forward-random-1", 2),
        ("forward-expert-0", 4),
        ("forward-tta_default-0", 2),
        ("forward-ref_zero-0", 4),
        ("forward-ref_zero-1", 1),
    ]


def test_counts_and_bytes_by_hand() -> None:
    plan = make_plan(make_spec(tasks=("forward",)))
    assert plan.num_episodes == 10
    assert plan.num_tta_episodes == 2
    assert plan.num_steps == 10 * (10 + 2 + 5)
    # 12 stored episodes: 120 steps of 20 + 6 + 1 floats and 2 flags, 12 final observations,
    # 200 bytes of table per episode, 1 MB of slack
    assert plan.file_bytes == 120 * (27 * 4 + 2) + 12 * (80 + 200) + 1_000_000


def test_references_are_run_only_where_nothing_stored_tells() -> None:
    spec = make_spec(episodes=EpisodeCounts(medium=4), reference=1, tta={}, tasks=(0,))
    assert labels(spec) == [
        ("forward-medium-0", 4),
        ("forward-ref_zero-0", 1),
        ("forward-ref_random-0", 1),
        ("forward-ref_expert-0", 1),
    ]


def test_references_on_record_are_not_run() -> None:
    """zero and random of forward are known, its expert is another one; of backward nothing."""
    spec = make_spec(episodes=EpisodeCounts(medium=4), reference=1, tta={})
    known = Record({"zero": Reference(0.0, 0.1, 20), "random": Reference(1.0, 0.1, 20)})
    plan = make_plan(spec, {"forward": known})
    assert [block.label for block in plan.of_kind("reference")] == [
        "forward-ref_expert-0",
        "backward-ref_zero-0",
        "backward-ref_random-0",
        "backward-ref_expert-0",
    ]
    assert plan.on_record(plan.tasks[0]) is known and plan.on_record(plan.tasks[1]) is NOTHING


def test_history_numbers_hold_the_rung() -> None:
    spec = make_spec(
        episodes=EpisodeCounts(random=1, expert=1, history=14), tta={}, reference=1, tasks=(0,)
    )
    history = make_plan(spec).of_kind("episodes", "history")
    # 14 over 3 rungs = 5, 4, 5; in blocks of 4: 4+1, 4, 4+1
    assert [(b.number, b.rows) for b in history] == [
        (0, 4), (1, 1), (65536, 4), (131072, 4), (131073, 1),
    ]  # fmt: skip
    assert HISTORY_STRIDE == 65536


@pytest.mark.parametrize(
    ("count", "places", "wanted"),
    [(5, 2, [3, 2]), (3, 5, [1, 0, 1, 0, 1]), (1, 5, [1, 0, 0, 0, 0]), (0, 2, [0, 0]),
     (6, 3, [2, 2, 2]), (4, 20, [1] + [0] * 5 + [1] + [0] * 6 + [1] + [0] * 5 + [1])],
)  # fmt: skip
def test_spread_is_even_and_reaches_both_ends(count: int, places: int, wanted: list[int]) -> None:
    assert spread(count, places) == wanted
    assert sum(spread(count, places)) == count


def test_keys_are_positions() -> None:
    plan = make_plan(make_spec())
    block = plan.of_kind("episodes", "random")[3]  # second block of the second task
    assert block.label == "backward-random-1"
    keys = block.keys(plan.family, plan.spec.seed)
    assert [key.spawn_key for key in keys] == [(0, 1, 0, 1, 0), (0, 1, 0, 1, 1)]
    assert {key.seed for key in keys} == {3}


def test_more_of_anything_changes_no_existing_block() -> None:
    small = make_spec(tasks=("backward",))
    large = make_spec(episodes=EpisodeCounts(random=8, medium=4, expert=9, history=6))
    before = {key.spawn_key for key in _keys(small)}
    after = {key.spawn_key for key in _keys(large)}
    assert before < after


def _keys(spec: DatasetSpec) -> list[object]:
    plan = make_plan(spec)
    return [key for block in plan.blocks for key in block.keys(plan.family, spec.seed)]


def test_blocks_are_in_canonical_order_and_labels_unique() -> None:
    plan = make_plan(make_spec(episodes=EpisodeCounts(random=9, medium=9, expert=9, history=9)))
    order = [(b.task.index, int(b.quality), b.number) for b in plan.blocks]
    assert order == sorted(order)
    assert len({b.label for b in plan.blocks}) == len(plan.blocks)


def test_tta_rule_says_which_tasks_and_how_long() -> None:
    rules = {
        "short": TtaRule(episodes=1, horizon=7, action_scale=2.0),
        "trained": TtaRule(episodes=1, tasks="train"),
    }
    plan = make_plan(make_spec(family="ml10", behaviour=Behaviour(script="metaworld"), tta=rules))
    short, trained = plan.of_kind("tta", "short"), plan.of_kind("tta", "trained")
    assert {b.task.role for b in short} == {"test"} and len(short) == 5
    assert {b.task.role for b in trained} == {"train"} and len(trained) == 10
    assert {(b.horizon, b.action_scale, b.quality) for b in short} == {(7, 2.0, Quality.TTA)}
    both = make_plan(make_spec(tta=rules))  # cheetah_dir: every task is train and test
    assert len(both.of_kind("tta", "short")) == len(both.of_kind("tta", "trained")) == 2


def test_width_is_the_block() -> None:
    assert make_plan(make_spec()).width == 4
    assert make_plan(make_spec(family="ml10", behaviour=Behaviour(script="metaworld"))).width == 4


def test_steps_of_a_block() -> None:
    task = make_plan(make_spec()).tasks[0]
    assert Block("episodes", "random", task, Quality.RANDOM, 0, 3, 10).steps == 30
