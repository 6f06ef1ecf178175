"""Numbered goals: who uses which, and that no training episode meets a held-out one."""

from __future__ import annotations

from mpdt.data.spec.goals import GoalSet
from mpdt.seeding import HISTORY_STRIDE, Quality, SeedKey

FOUR_OF_SIX = GoalSet(count=6, held_out=2)


def number(key: SeedKey) -> int:
    assert (key.seed, key.family, key.task) == (9, 5, 3), "the task's goals, of the same spec"
    assert (key.quality, key.block) == (Quality.GOALS, 0), "shared by all qualities and blocks"
    return key.row


def episode(quality: Quality, block: int, row: int) -> SeedKey:
    return SeedKey(9, 5, 3, int(quality), block, row)


def test_training_goals_come_in_turn_across_blocks() -> None:
    places = [(block, row) for block in range(2) for row in range(3)]
    keys = [episode(Quality.EXPERT, block, row) for block, row in places]
    assert [number(FOUR_OF_SIX.training_key(key, 3)) for key in keys] == [0, 1, 2, 3, 0, 1]


def test_each_rung_of_history_starts_one_goal_later() -> None:
    blocks = [rung * HISTORY_STRIDE for rung in (0, 1, 4)]
    keys = [episode(Quality.HISTORY, block, row) for block in blocks for row in range(2)]
    assert [number(FOUR_OF_SIX.training_key(key, 10)) for key in keys] == [0, 1, 1, 2, 0, 1]


def test_unseen_goals_are_the_last_ones() -> None:
    keys = [episode(Quality.TTA, 1, row) for row in range(3)]
    assert [number(FOUR_OF_SIX.held_out_key(key, 3)) for key in keys] == [5, 4, 5]


def test_all_qualities_share_goals() -> None:
    ours = [FOUR_OF_SIX.training_key(episode(q, 0, 2), 3) for q in (Quality.RANDOM, Quality.EXPERT)]
    assert ours[0] == ours[1]


def test_numbers_that_hold_out_nothing_or_everything_are_a_problem() -> None:
    assert not FOUR_OF_SIX.problem
    for held_out in (0, 6, 7, -1):
        assert GoalSet(count=6, held_out=held_out).problem
