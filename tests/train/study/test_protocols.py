"""The table of protocols: rows that read the same are compared, and nothing else."""

import pytest

from mpdt.train.evaluate.score import MEAN, Score
from mpdt.train.study.cells import CellResult
from mpdt.train.study.once import pooled
from mpdt.train.study.protocols import PROTOCOLS, protocols_table, split_own
from mpdt.train.study.summary import task_intervals


def cell(seed, rows, success=None):
    scores = [
        Score(block="test", task=task, method=method, mean=mean, low=mean - 1, high=mean + 1,
              normalised=mean / 10, success=success, reads=reads)
        for method, mean, reads in rows for task in (MEAN, "t")
    ]  # fmt: skip
    return CellResult("d", "m", seed, tuple(scores), {})


@pytest.mark.parametrize(
    ("method", "found"),
    [("ones-alone 10 own episodes", ("ones-alone", 10)), ("m infer", ("m infer", 0)),
     ("m X and 1 own episode", ("m X and", 1)), ("m 10 own episodes later", ("m 10 own episodes "
                                                                              "later", 0))],
)  # fmt: skip
def test_the_number_of_own_episodes_is_read_off_the_name(method, found):
    assert split_own(method) == found


@pytest.mark.parametrize(
    ("method", "found"),
    [("ones-alone-t1 10 own episodes", "ones-alone 10 own episodes"), ("ones-t12", "ones"),
     ("rank-10 infer", "rank-10 infer"), ("m from-t1x", "m from-t1x"), ("a b-t1", "a b-t1")],
)  # fmt: skip
def test_seeds_of_trials_are_runs_of_one_method(method, found):
    assert pooled(method) == found


def test_each_protocol_has_the_best_of_its_own_rows():
    read = [
        ("zero action", 1.0, None), ("m infer", 5.0, "X+rewards"), ("n infer", 4.0, "X+rewards"),
        ("m 3 own episodes", 7.0, "trials"), ("m 10 own episodes", 9.0, "trials"),
        ("m few-shot", 8.0, "labelled steps"), ("m own prompts", 6.0, "task id"),
        ("m not adapted", 3.0, "nothing"),
    ]  # fmt: skip
    table = protocols_table([cell(0, read)])
    told = {line[1]: (line[2], *line[5:]) for line in table.rows}
    assert told == {
        "zero action": ("1.0", "0.10", "-", "-", "-"),
        "nothing": ("3.0", "0.30", "m not adapted", "1", "1"),
        "the task's name": ("6.0", "0.60", "m own prompts", "1", "1"),
        "X and rewards, inferred": ("5.0", "0.50", "m infer", "1", "2"),
        "3 own episodes": ("7.0", "0.70", "m 3 own episodes", "1", "1"),
        "10 own episodes": ("9.0", "0.90", "m 10 own episodes", "1", "1"),
        "labelled steps or a demonstration": ("8.0", "0.80", "m few-shot", "1", "1"),
    }
    absent = [one.name for one in PROTOCOLS if one.name not in told]
    assert table.notes[1] == f"d: no row that reads {', '.join(absent)}"
    few = protocols_table([cell(0, read[:2])]).notes[1]
    assert "nothing, X alone" in few, "of an unseen class there is no name to be told"


def test_trials_of_several_seeds_are_one_row_and_no_more_seeds():
    """Runs earn 2 and 3 with one training seed, 4 and 7 with the other: 2.5 and 5.5."""
    earned = {(0, 0): 2.0, (0, 1): 3.0, (1, 0): 4.0, (1, 1): 7.0}
    cells = [
        cell(seed, [(f"m-t{again} 3 own episodes", mean, "trials")])
        for (seed, again), mean in earned.items()
    ]
    ((_, name, mean, interval, _, reached, method, seeds, of),) = protocols_table(cells).rows
    assert (name, mean, reached) == ("3 own episodes", "4.0", "0.40")
    assert (method, seeds, of) == ("m 3 own episodes", "2 (4 runs)", "1")
    assert interval == "[-15.1, 23.1]", "Student's t over two seeds: 4 -+ 12.71 * 1.5"


def test_a_seed_counts_once_however_many_runs_it_has():
    """Three runs of 2 without a success, one run of 8 with one."""
    earned = [(0, 0, 2.0, 0.0), (0, 1, 2.0, 0.0), (0, 2, 2.0, 0.0), (1, 0, 8.0, 1.0)]
    cells = [cell(seed, [(f"m-t{again} 3 own episodes", mean, "trials")], success)
             for seed, again, mean, success in earned]  # fmt: skip
    ((_, _, mean, _, success, level, _, seeds, _),) = protocols_table(cells).rows
    assert (mean, success, level, seeds) == ("5.0", "50%", "0.50", "2 (4 runs)")
    assert task_intervals(cells, "test")["t"]["m 3 own episodes"][0] == 5.0


def test_runs_of_one_training_seed_know_nothing_of_others():
    """The intervals of their episodes, [1, 3] and [3, 5], averaged."""
    cells = [cell(0, [(f"m-t{again} 3 own episodes", 2.0 + 2 * again, "trials")])
             for again in (0, 1)]  # fmt: skip
    ((_, _, mean, interval, _, _, _, seeds, _),) = protocols_table(cells).rows
    assert (mean, interval, seeds) == ("3.0", "[2.0, 4.0]", "1 (2 runs)")
    assert task_intervals(cells, "test")["t"]["m 3 own episodes"] == (3.0, 2.0, 4.0)
