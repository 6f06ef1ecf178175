"""The published quality levels as slices of history, and cuts by progress and return.

tiny.h5: per task four history episodes of progress 0, 0, 0.5, 1 (ids 12-15 and 28-31).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mpdt.data.slices.choice import first_of_each, in_progress, parse_progress
from mpdt.data.slices.cut import Cut, choose
from mpdt.data.slices.standard import standard_slices
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset
from mpdt.errors import UsageError


@pytest.fixture
def data(tiny_file: Path) -> Dataset:
    return open_dataset(tiny_file)


def test_paper_levels_by_hand(data: Dataset) -> None:
    slices = data.slices
    assert slices["paper-random"].tolist() == [12, 13, 28, 29]
    assert slices["paper-medium"].tolist() == [14, 30]
    assert slices["paper-expert"].tolist() == [15, 31]
    mixed = slices["paper-mixed"].tolist()
    assert len(mixed) == 6  # one of each level and task
    assert {14, 15, 30, 31} < set(mixed)
    assert data.slice_rules["paper-medium"] == {"quality": "history", "progress": [0.35, 0.65]}
    assert data.slice_rules["paper-mixed"]["equal_parts"] == [
        "paper-random", "paper-medium", "paper-expert",
    ]  # fmt: skip


def test_training_and_test_tasks(data: Dataset) -> None:
    """Both tasks of tiny.h5 are both; here one of them is of one kind."""
    assert data.tasks.train_rows == data.tasks.test_rows == [0, 1]
    apart = replace(data, tasks=replace(data.tasks, roles=np.array([0, 1], np.int8)))
    found = standard_slices(apart)
    assert set(data.episodes.task[found["train"].ids]) == {0}
    assert set(data.episodes.task[found["test"].ids]) == {1}


def test_the_mixed_part_of_a_level_is_the_few_shot_choice(data: Dataset) -> None:
    one = first_of_each(data, data.slices["paper-random"], 1)
    assert set(one.tolist()) < set(data.slices["paper-mixed"].tolist())


def test_no_history_no_paper_levels(data: Dataset) -> None:
    data.episodes.quality[data.episodes.quality == 3] = 0
    assert {name for name in standard_slices(data) if name.startswith("paper")} == set()


def test_the_gaps_belong_to_no_level_and_float32_to_the_right_one(data: Dataset) -> None:
    """0.7 as float32 is 0.69999999; the shares of a ladder of 21 rungs go in steps of 0.05."""
    data.episodes.progress[:21] = np.arange(21) / 20
    ids = np.arange(21)
    assert float(np.float32(0.7)) < 0.7
    spans = {"random": (0, 0.3), "medium": (0.35, 0.65), "expert": (0.7, 1)}
    found = {name: in_progress(data, ids, *span).tolist() for name, span in spans.items()}
    assert found["random"] == [0, 1, 2, 3, 4, 5]  # 0 to 0.25
    assert found["medium"] == [7, 8, 9, 10, 11, 12]  # 0.35 to 0.60
    assert found["expert"] == [14, 15, 16, 17, 18, 19, 20]  # 0.70 to 1.00, both included


def test_unknown_progress_is_in_no_range(data: Dataset) -> None:
    data.episodes.progress[:] = -1
    assert len(in_progress(data, np.arange(32), 0, 1)) == 0


def test_cuts_by_progress_and_return(data: Dataset) -> None:
    assert choose(data, Cut(quality="history", progress=(0.5, 1.0))).tolist() == [14, 15, 30, 31]
    assert choose(data, Cut(quality="history", return_top=0.25)).tolist() == [15, 31]
    # The best half of task 0: four expert ones, history's last, and then the first of return 2.5.
    assert choose(data, Cut(tasks=("forward",), return_top=0.5)).tolist() == [
        4, 5, 6, 8, 9, 10, 11, 15,
    ]  # fmt: skip
    assert Cut(progress=(0.35, 0.65), return_top=0.5).suffix() == "-p0.35-0.65-top0.5"


@pytest.mark.parametrize("text", ["0.5", "a:b", "0.6:0.5", "0:2", "-1:1", ":", "0.3:0.3"])
def test_ranges_that_are_none(data: Dataset, text: str) -> None:
    if text == ":":
        assert parse_progress(text) == (0, 1)
        return
    with pytest.raises(UsageError, match="progress"):
        choose(data, Cut(progress=parse_progress(text)))
    with pytest.raises(UsageError, match="not a share"):
        choose(data, Cut(return_top=0.0))


def test_few_shot_slices_are_nested_and_absolute(tiny_file: Path) -> None:
    from mpdt.data.slices.split import split

    for count in (1, 2, 4):
        split(str(tiny_file), Cut(quality="expert", episodes=count), name=f"few-{count}")
    data = open_dataset(tiny_file)
    sets = [set(data.slices[f"few-{count}"].tolist()) for count in (1, 2, 4)]
    assert [len(ids) for ids in sets] == [2, 4, 8]
    assert sets[0] < sets[1] < sets[2] == {8, 9, 10, 11, 24, 25, 26, 27}
    assert data.slice_rules["few-2"] == {"quality": "expert", "episodes": 2}
