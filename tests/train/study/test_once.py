"""One set of weights, one row among those that read nothing; counted by hand."""

from __future__ import annotations

import pytest

from mpdt.train.evaluate.score import MEAN, Score
from mpdt.train.study.cells import CellResult
from mpdt.train.study.protocols import protocols_table
from mpdt.train.study.summary import summarise, task_intervals

NOT_ADAPTED = "P_c o mean P_k, not adapted"


def cell(label, seed, mean, training, data="d"):
    """Task t earns `mean` where nothing is read, twice as much inferred."""
    rows = [("random", 0.0, None), (f"{label} {NOT_ADAPTED}", mean, "nothing"),
            (f"{label} infer", 2 * mean, "X+rewards")]  # fmt: skip
    scores = [
        Score(block="test", task=task, method=method, mean=value, low=value - 1, high=value + 1,
              normalised=value / 10, reads=reads)
        for method, value, reads in rows for task in ("t", MEAN)
    ]  # fmt: skip
    content = {"identity": {"training": training}} if training else {}
    return CellResult(data, label, seed, tuple(scores), content)


def told(cells):
    return {row.method: (row.num_seeds, row.mean) for row in summarise(cells, "test")}


def test_weights_that_several_labels_judged_are_one_row():
    """Two seeds of two labels: 3 and 5 once each. What they inferred stays apart."""
    cells = [cell("b", 0, 3.0, "w0"), cell("b", 1, 5.0, "w1"),
             cell("a", 0, 3.0, "w0"), cell("a", 1, 5.0, "w1"), cell("c", 0, 7.0, "w9")]  # fmt: skip
    assert told(cells) == {
        "random": (1, 0.0), f"b {NOT_ADAPTED}": (2, 4.0), "b infer": (2, 8.0),
        "a infer": (2, 8.0), f"c {NOT_ADAPTED}": (1, 7.0), "c infer": (1, 14.0),
    }  # fmt: skip
    line = next(line for line in protocols_table(cells).rows if line[1] == "nothing")
    assert line[6:] == (f"c {NOT_ADAPTED}", "1", "2"), "the best of two rows, not of three"
    assert set(task_intervals(cells, "test")["t"]) == set(told(cells))
    assert len(cells[2].scores) == 6, "and cells are as they were"


def test_the_label_with_most_of_the_weights_has_them_all():
    cells = [cell("few", 0, 3.0, "w0"), cell("few", 3, 9.0, "w3"),
             *(cell("most", seed, 3.0 + seed, f"w{seed}") for seed in (0, 1, 2))]  # fmt: skip
    found = told(cells)
    assert found[f"most {NOT_ADAPTED}"] == (4, (3.0 + 4.0 + 5.0 + 9.0) / 4)
    assert f"few {NOT_ADAPTED}" not in found and found["few infer"] == (2, 12.0)


def test_among_equals_the_name_is_that_of_the_study():
    cells = [cell("few-shot-all", 0, 3.0, "w0", "ml10"), cell("ones-long", 0, 3.0, "w0", "ml10")]
    assert f"ones-long {NOT_ADAPTED}" in told(cells) and len(told(cells)) == 4


def test_seeds_of_trials_judge_the_same_weights():
    """Two of each training seed: still two seeds, so the interval is not too narrow."""
    cells = [
        cell(f"m-t{again}", seed, 2.0 + seed, f"w{seed}") for seed in (0, 1) for again in (0, 1)
    ]
    assert told(cells)[f"m {NOT_ADAPTED}"] == (2, 2.5) and told(cells)["m infer"] == (2, 5.0)


@pytest.mark.parametrize("other", [None, "w1"])
def test_weights_that_are_others_or_unknown_stay(other):
    cells = [cell("a", 0, 3.0, other), cell("b", 0, 3.0, None)]
    assert len(told(cells)) == 5
