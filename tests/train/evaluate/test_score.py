"""Scores and verdicts with numbers worked out by hand; results.json."""

import json

import numpy as np
import pytest

from mpdt.data.reference import UNKNOWN, Reference
from mpdt.train.evaluate.aggregate import goal_means
from mpdt.train.evaluate.score import (
    EXPERT,
    MEAN,
    RANDOM,
    ZERO,
    Score,
    encode_results,
    expert_scores,
    scores_of,
    with_verdicts,
)
from mpdt.train.run.results import scores_in


def test_scores_by_hand():
    scores = scores_of(
        "train", "MPDT", ["a", "b"],
        np.array([[10.0, 30.0], [0.0, 0.0]]), np.array([[True, False], [False, False]]),
        random=np.array([0.0, -10.0]), expert=np.array([40.0, 10.0]),
    )  # fmt: skip
    first, second, mean = scores
    assert (first.mean, first.low, first.high) == (20.0, 10.0, 30.0)
    assert (first.normalised, first.success, first.num_episodes) == (0.5, 0.5, 2)
    assert (second.mean, second.normalised, second.success) == (0.0, 0.5, 0.0)
    assert (mean.task, mean.mean, mean.normalised) == (MEAN, 10.0, 0.5)
    assert (mean.success, mean.num_episodes) == (0.25, 4)


@pytest.mark.parametrize("times", [1, 2, 10])
def test_goals_that_come_again_do_not_make_an_interval_narrower(times):
    """Five goals in turn, of two tasks: whatever E, they are five episodes of each."""
    returns = np.array([[0.0, 10, 20, 30, 40], [0.0, 0, 0, 0, 50]])
    known = {"random": np.zeros(2), "expert": np.ones(2)}
    again = np.tile(returns, times)
    once, shared = (scores_of("test", "m", ["a", "b"], each, again_wins, **known, goals=goals)
                    for each, again_wins, goals in ((returns, returns > 0, None),
                                                    (again, again > 0, 5)))  # fmt: skip
    for one, other in zip(once, shared, strict=True):
        assert (one.mean, one.low, one.high, one.success) == (
            other.mean, other.low, other.high, other.success)  # fmt: skip
    assert shared[0].num_episodes == 5 * times
    narrow = scores_of("test", "m", ["a", "b"], again, None, **known)
    assert times == 1 or narrow[-1].high - narrow[-1].low < once[-1].high - once[-1].low


def test_goals_that_do_not_come_equally_often_count_once_each():
    """Episodes 0 to 6 have goals 0 1 2 3 4 0 1: 1 and 5 for the first, 2 and 8 for the second."""
    assert goal_means(np.array([[1.0, 2, 3, 4, 5, 5, 8]]), 5).tolist() == [[3, 5, 3, 4, 5]]
    assert goal_means(np.array([[1.0, 2, 3]]), 5).tolist() == [[1, 2, 3]]


def test_the_expert_by_hand():
    """Intervals of 1.96 errors: 21 +- 1.96 and 40 +- 3.92; success of b was never counted.

    Mean over tasks 30.5, its error sqrt(1 + 4) / 2.
    """
    experts = [Reference(21.0, 1.0, 100, 0.5), Reference(40.0, 2.0, 50)]
    a, b, mean = expert_scores("test", ["a", "b"], experts, random=np.array([1.0, 40.0]))
    assert (a.method, a.mean, a.low, a.high, a.success) == (EXPERT, 21.0, 19.04, 22.96, 0.5)
    assert (a.normalised, a.num_episodes) == (1.0, 100)
    assert (b.mean, b.low, b.high, b.success) == (40.0, 36.08, 43.92, None)
    assert np.isnan([b.normalised, mean.normalised]).all(), "random is as good as the expert"
    assert (mean.task, mean.mean, mean.success, mean.num_episodes) == (MEAN, 30.5, None, 150)
    assert mean.high - mean.mean == pytest.approx(1.96 * 5**0.5 / 2)


def test_an_expert_whose_error_is_not_known_has_no_interval():
    one, mean = expert_scores("train", ["a"], [Reference(3.0, np.nan, 1)], np.zeros(1))
    for score in (one, mean):
        assert score.mean == 3.0 and np.isnan([score.low, score.high]).all()


def test_the_expert_of_another_horizon_is_not_measured():
    one, mean = expert_scores("train", ["a"], [UNKNOWN], np.full(1, np.nan))
    for score in (one, mean):
        assert np.isnan([score.mean, score.low, score.normalised]).all()
        assert score.success is None and score.num_episodes == 0


def rated(method, low, high, task="a", block="train", episodes=5):
    return Score(block=block, task=task, method=method, mean=(low + high) / 2, low=low, high=high,
                 normalised=0.0, num_episodes=episodes)  # fmt: skip


@pytest.mark.parametrize(
    ("low", "verdict"), [(4.0, True), (3.0, False), (2.0, False), (-9.0, False)]
)
def test_verdict_by_hand(low, verdict):
    """Zero action [0, 3], random [-5, 1]: an interval beats them from above 3."""
    trivial = [rated(ZERO, 0.0, 3.0), rated(RANDOM, -5.0, 1.0)]
    *_, score = with_verdicts([*trivial, rated("MPDT", low, 9.0)])
    assert score.beats_trivial is verdict
    # Either of the two alone is not enough.
    *_, score = with_verdicts([rated(RANDOM, 0.0, 3.0), rated(ZERO, -5, 1), rated("x", low, 9.0)])
    assert score.beats_trivial is verdict


def test_verdicts_need_all_intervals_of_the_task():
    trivial = [rated(ZERO, 0.0, 3.0), rated(RANDOM, 0.0, 1.0)]
    for scores in (
        [*trivial, rated("MPDT", 5.0, 9.0, task="b")],
        [*trivial, rated("MPDT", 5.0, 9.0, block="test")],
        [*trivial, rated("MPDT", 5.0, 9.0, episodes=1)],
        [trivial[0], rated(RANDOM, np.nan, np.nan), rated("MPDT", 5.0, 9.0)],
        [*trivial, rated(EXPERT, 5.0, 9.0)],
    ):
        assert all(score.beats_trivial is None for score in with_verdicts(scores))


def test_results_hold_no_nan(tmp_path):
    nan = float("nan")
    score = Score(block="test", task="a", method="x", mean=1.0, low=nan, high=nan, normalised=0.5)
    decoded = json.loads(encode_results({"name": "r"}, [score]))
    assert decoded["name"] == "r"
    assert decoded["scores"][0]["low"] is None and decoded["scores"][0]["mean"] == 1.0
    assert not {"beats_trivial", "reads"} & set(decoded["scores"][0])


def test_results_are_read_back(tmp_path):
    nan = float("nan")
    said = Score(block="train", task="a", method="x", mean=1.0, low=0.0, high=2.0, normalised=nan,
                 beats_trivial=False, reads="X")  # fmt: skip
    (score,) = scores_in(json.loads(encode_results({}, [said])))
    assert (score.beats_trivial, score.reads) == (False, "X") and np.isnan(score.normalised)
