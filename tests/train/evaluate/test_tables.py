"""The tables as text."""

import pytest

from mpdt.draw.table import markdown_page, rich_tables
from mpdt.train.evaluate.score import MEAN, Score
from mpdt.train.evaluate.tables import NOT_MEASURED, build_tables

NAN = float("nan")


def score(
    task, method, mean, low=NAN, high=NAN, success=None, normalised=0.5, block="train", **more
):
    return Score(block=block, task=task, method=method, mean=mean, low=low, high=high,
                 normalised=normalised, success=success, **more)  # fmt: skip


SCORES = [
    score("run", "zero action", 0.0),
    score(MEAN, "zero action", 0.0),
    score("run", "MPDT", 1234.5, 1200.0, 1300.0, success=0.8),
    score(MEAN, "MPDT", 1234.5, 1200.0, 1300.0, success=0.8),
]


def test_tables_by_hand():
    tasks, means = build_tables(SCORES)
    assert tasks.columns == ("task", "zero action", "MPDT")
    assert tasks.rows[0] == ("run", "0.0", "1234 [1200, 1300] 80% (0.50)")
    assert means.columns == ("method", "mean return", "95 % interval", "normalised", "success")
    assert means.rows == (
        ("zero action", "0.0", "-", "0.50", "-"),
        ("MPDT", "1234", "[1200, 1300]", "0.50", "80%"),
    )


def test_no_success_column_without_success():
    tasks, means = build_tables([score("a", "x", 1.0), score(MEAN, "x", 1.0)])
    assert "success" not in means.columns and "success" not in tasks.title


def test_what_was_not_measured_says_so():
    tasks, means = build_tables([score("a", "x", NAN), score("a", "y", 1.0), score("b", "y", 1.0)])
    assert tasks.rows == (("a", NOT_MEASURED, "1.0"), ("b", NOT_MEASURED, "1.0"))
    assert means.rows[0] == ("x", NOT_MEASURED, "-", "-")


def test_blocks_stand_apart():
    tables = build_tables([score("a", "x", 1.0), score("b", "x", 2.0, block="test")])
    assert [table.rows[0][0] for table in tables[::2]] == ["a", "b"]


def test_verdicts_stand_below_the_table_of_their_block():
    """2 of 3 training tasks; neither the mean over tasks nor what was not compared counts."""
    verdicts = [("a", True), ("b", False), ("c", True), (MEAN, True), ("d", None)]
    tables = build_tables(
        [score(task, "MPDT", 1.0, beats_trivial=verdict) for task, verdict in verdicts]
        + [score("a", "random", 0.0), score("x", "MPDT", 1.0, block="test")]
    )
    line = "MPDT beats zero action and random (intervals apart): 2 of 3 training tasks"
    assert [table.notes for table in tables] == [(line,), (), (), ()]
    text = markdown_page({}, tables)
    assert f"|\n\n{line}\n\n## " in text
    assert str(rich_tables(tables)[0].caption) == line


@pytest.mark.parametrize(
    ("test", "said"),
    [
        ("cd", "never trained on"),
        ("ab", "the training tasks again, behind other prompts"),
        ("bcd", "1 of 3 are training tasks as well"),
    ],
)
def test_the_title_says_whether_training_knew_the_test_tasks(test, said):
    scores = [score(task, "MPDT", 1.0) for task in ("a", "b", MEAN)]
    scores += [score(task, "random", 1.0, block="test") for task in (*test, MEAN)]
    titles = [table.title for table in build_tables(scores)]
    assert titles[2].startswith(f"Test tasks ({said}): return")
    assert titles[3] == f"Test tasks ({said}): mean over tasks"
    alone = build_tables([one for one in scores if one.block == "test"])
    assert alone[1].title == "Test tasks: mean over tasks", "nothing there to tell it by"


def test_a_column_says_what_was_read_of_the_test_tasks():
    """Not in the table of training tasks, where there is nothing to say."""
    scores = [score(MEAN, "random", 1.0, block=block) for block in ("train", "test")]
    scores += [score(MEAN, "infer", 2.0, block="test", reads="X+rewards")]
    train, test = build_tables(scores)[1::2]
    assert "reads" not in train.columns and test.columns[-1] == "reads"
    assert [row[-1] for row in test.rows] == ["-", "X+rewards"]


def test_markdown_and_terminal_hold_the_same_cells():
    tables = build_tables(SCORES)
    text = markdown_page({"name": "demo", "data": "x.h5"}, tables)
    assert text.startswith("# demo\n\n- data: x.h5\n")
    assert "| run | 0.0 | 1234 [1200, 1300] 80% (0.50) |" in text
    assert [len(table.columns) for table in rich_tables(tables)] == [3, 5]
