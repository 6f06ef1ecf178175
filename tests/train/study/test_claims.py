"""Verdicts and goals from rows made by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mpdt.train.adapt.align import LABELS
from mpdt.train.evaluate.score import MEAN, Score
from mpdt.train.report.study_tables import report_tables
from mpdt.train.study import goals
from mpdt.train.study.cells import CellResult
from mpdt.train.study.claims import CLAIMED_OF, CLAIMS, Claim
from mpdt.train.study.goals import GOALS, Goal, goals_table
from mpdt.train.study.plans import STUDIES
from mpdt.train.study.protocols import FEW_SHOT, TRIALS, X_AND_TRIALS
from mpdt.train.study.study import configure
from mpdt.train.study.summary import Row
from mpdt.train.study.verdicts import claims_table, judge_claim, qualified_verdict, verdicts_table


def row(low, high, method="m"):
    return Row(method, "X", 1, (low + high) / 2, (low, high), np.zeros((1, 1)), None)


@pytest.mark.parametrize(
    ("behind", "verdict"),
    [((1, 2), "confirmed"), ((1, 4), "not confirmed"), ((3, 4), "not confirmed"),
     ((6, 7), "reversed"), ((4.5, 7), "not confirmed")],
)  # fmt: skip
def test_a_verdict_is_two_intervals(behind, verdict):
    """The one said to be ahead has [3, 5]."""
    rows = {"a": row(3, 5), "b": row(*behind)}
    assert judge_claim(rows, Claim("", "d", "a", "b")) == verdict
    assert judge_claim({"a": row(3, 5)}, Claim("", "d", "a", "b")) == "not run"


def test_a_verdict_says_how_few_seeds_it_has_and_whether_anything_was_learnt():
    """Zero action earns [0, 0.9]."""
    three = replace(row(3, 5), num_seeds=3)
    rows = {"zero action": row(0, 0.9), "a": three, "b": three, "c": row(1, 2), "d": row(-2, -1)}
    assert qualified_verdict(rows, Claim("", "d", "a", "b")) == "not confirmed"
    assert qualified_verdict(rows, Claim("", "d", "a", "c")) == "confirmed, 1 seed of one side"
    assert qualified_verdict(rows, Claim("", "d", "c", "d")) == "confirmed, 1 seed"
    said = "confirmed, 1 seed, no better than zero action"
    for own in ((-0.5, 0.5), (0.5, 3)):
        below = {**rows, "c": row(*own)}
        assert qualified_verdict(below, Claim("", "d", "c", "d")) == said
    assert qualified_verdict(rows, Claim("", "d", "a", "e")) == "not run"


def test_claims_name_rows_that_their_study_makes():
    """A renamed one would silently be `not run`. On cheetah_vel there are three seeds of each."""
    seeds = {}
    for cell in (cell for study in CLAIMED_OF for cell in STUDIES[study]):
        config = configure(cell)
        starts = [LABELS[start] for start in config.adapt.starts if start != "none"]
        decomposed = config.prompts.kind == "decomposed"
        for row in (*starts, LABELS["none"] if decomposed else "not adapted"):
            seeds.setdefault((cell.data, f"{config.method} {row}"), set()).add(cell.seed)
    for claim in CLAIMS:
        for name in (claim.ahead, claim.behind):
            wanted = {0, 1, 2} if claim.data == "cheetah_vel" else {0}
            assert seeds.get((claim.data, name), set()) >= wanted, (claim.data, name)


def score(method, mean, block="test", reads="X", success=None, normalised=0.5):
    task = [MEAN, "t"]
    return [
        Score(block=block, task=name, method=method, mean=mean, low=mean - 1, high=mean + 1,
              normalised=normalised, success=success, reads=reads if block == "test" else None)
        for name in task
    ]  # fmt: skip


@pytest.fixture
def cells():
    scores = [
        *score("zero action", 200.0, reads=None), *score("expert", 4000.0, reads=None),
        *score("A infer", 3700.0, success=0.95, reads="X+rewards"), *score("A few-shot", 3900.0,
        reads="labelled steps", success=1.0), *score("A", 3800.0, "train", normalised=0.92),
    ]  # fmt: skip
    return [CellResult("mt10", "A", 0, tuple(scores), {})]


def test_goals_count_only_what_reads_at_most_x_and_rewards(cells):
    table = goals_table(cells)
    by_name = {line[0]: line for line in table.rows}
    assert list(by_name) == [goal.name for goal in GOALS] and by_name["ml10"][1] == "not run"
    assert by_name["mt10"] == (
        "mt10", "missed", "4000, 98%", "3700.0 [3699.0, 3701.0], 95%",
        "A infer (X+rewards; seeds: 1; best of 1)", "0.92 of 0.9", "1317.52",
        "200.0", "-", "-", "4000.0",
    )  # fmt: skip


def test_a_goal_is_missed_by_any_of_its_parts(cells, monkeypatch):
    for goal in (Goal("mt10", 3701, 0.9, 0.0), Goal("mt10", 3600, 0.93, 0.0),
                 Goal("mt10", 3600, 0.9, 0.0, success=0.96)):  # fmt: skip
        monkeypatch.setattr(goals, "GOALS", (goal,))
        assert goals_table(cells).rows[0][1] == "missed"


@pytest.mark.parametrize(("share", "told"), [(0.8996, "0.8996"), (0.894, "0.89"), (0.9, "0.90")])
def test_training_tasks_that_miss_by_a_hair_do_not_look_as_if_they_did_not(
    share, told, monkeypatch
):
    scores = (
        *score("A infer", 9.0, reads="X+rewards"),
        *score("A", 9.0, "train", normalised=share),
    )
    cells = [CellResult("mt10", "A", 0, scores, {})]
    (line,) = goals_table_of(monkeypatch, cells, Goal("mt10", None, 0.9))
    assert line[5] == f"{told} of 0.9" and line[1] == ("met" if share >= 0.9 else "missed")


def test_a_cell_that_judges_again_does_not_reach_a_goal_of_training_tasks(cells, monkeypatch):
    """B earns more, but what its training tasks earn stands nowhere."""
    again = CellResult("mt10", "B", 0, tuple(score("B infer", 9000.0, reads="X+rewards")), {})
    (line,) = goals_table_of(monkeypatch, [*cells, again], Goal("mt10", 3600, 0.9, None))
    assert line[4].startswith("A infer")
    (line,) = goals_table_of(monkeypatch, [*cells, again], Goal("mt10", 3600, None, None))
    assert line[4].startswith("B infer") and line[5] == "-"


@pytest.mark.parametrize(
    ("asked", "verdict"),
    [(3698, "met"), (3699, "met"), (3700, "met, within error"), (3701, "missed")],
)
def test_a_goal_inside_the_interval_is_met_within_error(cells, monkeypatch, asked, verdict):
    """The row is 3700 [3699, 3701]."""
    (line,) = goals_table_of(monkeypatch, cells, Goal("mt10", asked))
    assert line[1] == verdict


def goals_table_of(monkeypatch, cells, goal):
    monkeypatch.setattr(goals, "GOALS", (goal,))
    return goals_table(cells).rows


def test_a_goal_of_own_episodes_looks_at_its_own_count(cells, monkeypatch):
    """Neither more of them nor a row that reads X as well."""
    tried = [one for method, reads in (("a 3 own episodes", "trials"), ("b 10 own episodes",
             "trials"), ("c X and 3 own episodes", "X+rewards, trials"))
             for one in score(method, 9.0, reads=reads)]  # fmt: skip
    tried = [CellResult("mt10", "A", 0, tuple(tried), {})]
    (line,) = goals_table_of(monkeypatch, tried, Goal("mt10", 8, reads=TRIALS, own=3))
    assert line[:2] == ("mt10, 3 own episodes", "met") and line[4].startswith("a 3 own episodes")
    assert line[4].endswith("best of 1)")
    (line,) = goals_table_of(monkeypatch, tried, Goal("mt10", 9, reads=X_AND_TRIALS, own=3))
    assert line[0] == "mt10, X and 3 own episodes" and line[4].startswith("c X and 3")


def test_a_goal_of_success_alone_is_judged_by_the_row_of_most_success(monkeypatch):
    rows = [one for method, mean, success in (("a", 9.0, 0.2), ("b", 5.0, 0.4))
            for one in score(method, mean, success=success)]  # fmt: skip
    tried = [CellResult("ml45", "A", 0, tuple(rows), {})]
    (line,) = goals_table_of(monkeypatch, tried, Goal("ml45", None, success=0.3))
    assert line[1] == "met" and line[4].startswith("b ")
    (line,) = goals_table_of(monkeypatch, tried, Goal("ml45", 8, success=0.3))
    assert line[1] == "missed" and line[4].startswith("a ")


def test_a_goal_of_other_data_looks_at_its_own_cell_and_the_usual_ones_pass_it_by():
    labels = ("ones-medium", "ones-long", "plain-medium")
    rows = [replace(row(1, 2, f"{label} infer"), reads="X+rewards") for label in labels]
    usual, medium = Goal("mt50", None), Goal("mt50", None, trained_on=goals.MEDIUM)
    assert [usual.counts(one) for one in rows] == [False, True, False]
    assert [medium.counts(one) for one in rows] == [True, False, True]
    assert medium.name == "mt50, medium data"
    inferred = Goal("mt50", None, reads=goals.INFERRED)
    assert inferred.name == "mt50, inferred" and inferred.counts(rows[1])
    assert not inferred.counts(replace(rows[1], reads="task id"))


def test_few_shot_goals_look_at_other_rows(cells, monkeypatch):
    monkeypatch.setattr(goals, "GOALS", (Goal("mt10", 3900, None, None, reads=FEW_SHOT),))
    (line,) = goals_table(cells).rows
    assert (
        line[0] == "mt10, few-shot"
        and line[4] == "A few-shot (labelled steps; seeds: 1; best of 1)"
    )
    assert line[5:7] == ("0.92", "not public") and line[1] == "met, within error"


def test_claims_without_rows_are_not_run(cells):
    table = claims_table(cells)
    assert {line[1] for line in table.rows} == {"not run"}
    assert len(table.rows) == len(CLAIMS)


def test_a_claim_has_one_line_and_each_family_its_own_verdict(monkeypatch):
    """Confirmed on one family, reversed on another, not run on a third, not asked of the fourth."""
    monkeypatch.setattr("mpdt.train.study.verdicts.CLAIMS", (
        *(Claim("a wins", data, "a infer", "b infer") for data in ("mt10", "ml10", "ml45")),
        Claim("b wins", "mt50", "b infer", "a infer"),
    ))  # fmt: skip
    trivial = {
        "mt10": (*score("zero action", 2.0), *score("best constant", math.nan)),
        "ml10": (*score("zero action", 2.0), *score("random", 3.0), *score("best constant", 4.0)),
        "mt50": (),
    }
    cells = [
        CellResult(data, "A", 0, (*score("a infer", a), *score("b infer", b), *trivial[data]), {})
        for data, a, b in (("mt10", 3700.0, 9.0), ("ml10", 9.0, 3700.0), ("mt50", 5.0, 5.5))
    ]
    table = verdicts_table(cells)
    assert table.columns == ("claim", "ml10", "mt10", "ml45", "mt50")
    assert table.rows == (
        ("a wins", "reversed, 1 seed: 9 / 3,700", "confirmed, 1 seed: 3,700 / 9", "not run", "-"),
        ("b wins", "-", "-", "-", "not confirmed, 1 seed: 6 / 5"),
        ("best of zero, random and constant action", "4.0", "2.0", "-", "-"),
    )


def test_figures_of_the_paper_stand_beside_a_claim_only_where_it_has_both():
    """In the order of the rows: MPDT first with `length 30`, second with `rank 10`."""
    published = {(claim.text, claim.data): claim.published for claim in CLAIMS}
    assert published["length 30 is better than length 3", "ml45"] == (347.21, 110.83)
    assert published["rank 10 is better than rank 1", "ml45"] == (350.33, 347.21)
    assert published["rank 10 is better than rank 1", "mt50"] is None
    assert published["rank 10 is better than rank 1: task inferred", "ml45"] is None


def test_a_claim_is_asked_once_of_a_family():
    """Two of one text would stand in one place of the table, one of them unseen."""
    asked = [(claim.text, claim.data) for claim in CLAIMS]
    assert len(set(asked)) == len(asked)


def test_a_study_of_these_data_begins_with_its_verdicts(cells):
    titles = [table.title for table in report_tables(cells, list(CLAIMED_OF))]
    verdicts = ["Goals on unseen tasks", "By protocol, on unseen tasks"]
    claimed = ["Verdicts by family", "Claims of the paper, and ours"]
    assert titles[:5] == [*verdicts, *claimed, "mt10: test tasks"]
    titles = [table.title for table in report_tables(cells, ["try"])]
    assert titles[:3] == [*verdicts, "mt10: test tasks"], "claims name another's rows"
    other = [CellResult("another", "A", 0, cells[0].scores, {})]
    assert report_tables(other, ["try"])[0].title == "another: test tasks"
