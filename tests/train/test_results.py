"""Scores and intervals with numbers worked out by hand; the log that can forget."""

import json

import numpy as np
import pytest

from mpdt.errors import StorageError
from mpdt.train.results import (
    MEAN,
    MetricsLog,
    Score,
    bootstrap,
    encode_results,
    normalised,
    reference_scores,
    scores_of,
    write_atomic,
)


def test_normalised_by_hand():
    assert normalised(30.0, 10.0, 50.0) == 0.5
    assert normalised(0.0, 10.0, 50.0) == -0.25
    assert np.isnan(normalised(1.0, 5.0, 5.0))


def test_bootstrap_of_equal_values_is_a_point():
    assert bootstrap(np.full((2, 5), 3.0)) == (3.0, 3.0)


def test_bootstrap_of_two_values_by_hand():
    """Mean of two draws from {0, 4}: 0, 2, 4 with chances 1/4, 1/2, 1/4, so the 2.5 % and
    97.5 % points are 0 and 4. Over 2 such tasks 0 and 4 have 1/16 each: still the ends."""
    assert bootstrap(np.array([[0.0, 4.0]])) == (0.0, 4.0)
    assert bootstrap(np.array([[0.0, 4.0]] * 2)) == (0.0, 4.0)


def test_bootstrap_keeps_tasks_fixed():
    """Tasks differ by 1000, their seeds do not: resampling tasks would widen the interval."""
    assert bootstrap(np.array([[0.0, 0.0], [1000.0, 1000.0]])) == (500.0, 500.0)


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


def test_references_have_no_interval_and_a_mean():
    rows = reference_scores(
        "test", "zero action", ["a", "b"],
        np.array([2.0, 4.0]), random=np.array([0.0, 0.0]), expert=np.array([4.0, 4.0]),
    )  # fmt: skip
    assert [row.mean for row in rows] == [2.0, 4.0, 3.0]
    assert [row.normalised for row in rows] == [0.5, 1.0, 0.75]
    assert np.isnan(rows[0].low)


def test_metrics_log_forgets_what_came_after_a_checkpoint(tmp_path):
    log = MetricsLog(tmp_path / "metrics.jsonl")
    log.append({"step": 1})
    size_bytes = log.size_bytes
    log.append({"step": 2})
    log.cut(size_bytes)
    log.append({"step": 3})
    assert log.records() == [{"step": 1}, {"step": 3}]


def test_results_hold_no_nan(tmp_path):
    nan = float("nan")
    score = Score(block="test", task="a", method="x", mean=1.0, low=nan, high=nan, normalised=0.5)
    decoded = json.loads(encode_results({"name": "r"}, [score]))
    assert decoded["name"] == "r"
    assert decoded["scores"][0]["low"] is None and decoded["scores"][0]["mean"] == 1.0


def test_atomic_write_replaces_and_cleans_up(tmp_path):
    target = tmp_path / "a.json"
    write_atomic(target, b"old")
    write_atomic(target, b"new")
    assert target.read_bytes() == b"new" and list(tmp_path.iterdir()) == [target]


def test_write_into_a_missing_folder_is_a_storage_error(tmp_path):
    with pytest.raises(StorageError, match="cannot write"):
        write_atomic(tmp_path / "gone" / "a.json", b"x")
