"""Interquartile mean and stratified bootstrap, worked by hand."""

import numpy as np
import pytest

from mpdt.train.evaluate.aggregate import bootstrap, iqm, mean, seed_interval, stratified_interval


def test_iqm_by_hand():
    assert iqm(np.array([100, 1, 3, 2, 4])) == 3.0
    assert iqm(np.array([[1.0, 2], [3, 4]])) == 2.5  # one score off each end
    assert iqm(np.array([7.0])) == 7.0
    assert iqm(np.array([0, 0, 1, 5, 5, 9, 9, 9])) == 5.0  # of 8, two off each end: 1 5 5 9


def test_runs_are_drawn_inside_their_task():
    """Task 0 always scores 0, task 1 always 10: no draw moves the mean, whatever the runs."""
    scores = np.array([[0.0, 10], [0, 10], [0, 10]])
    assert stratified_interval(scores, mean) == (5.0, 5.0)


def test_interval_by_hand():
    """Two runs of one task, 0 and 1: both draws 0 or both 1 with chance 1/4 each."""
    assert stratified_interval(np.array([[0.0], [1.0]]), mean) == (0.0, 1.0)
    low, high = stratified_interval(np.arange(20.0)[:, None], mean)
    # A mean of 20 draws from 0..19 has standard deviation 5.77 / sqrt(20) = 1.29.
    assert (low, high) == pytest.approx((9.5 - 1.96 * 1.29, 9.5 + 1.96 * 1.29), abs=0.2)


def test_same_seed_same_interval():
    scores = np.random.Generator(np.random.PCG64(0)).normal(size=(3, 4))
    assert stratified_interval(scores) == stratified_interval(scores)
    assert stratified_interval(scores) != stratified_interval(scores, seed=1)


def test_seeds_by_hand():
    """Means 0, 1, 2: spread 1, t(2) = 4.303. Which task a seed fails in does not matter."""
    reach = 4.3027 / 3**0.5
    expected = pytest.approx((1 - reach, 1 + reach), abs=1e-3)
    assert seed_interval(np.array([[0.0, 0], [1, 1], [2, 2]])) == expected
    assert seed_interval(np.array([[0.0, 0], [2, 0], [0, 4]])) == expected
    with pytest.raises(ValueError, match="one seed"):
        seed_interval(np.array([[1.0, 2.0]]))


def test_seeds_that_are_bad_everywhere_are_covered():
    """Tasks share their seed's error: t covers the truth, the stratified bootstrap does not."""
    generator = np.random.Generator(np.random.PCG64(1))
    hits = {seed_interval: 0, stratified_interval: 0}
    for _ in range(200):
        scores = np.repeat(generator.normal(size=(3, 1)), 5, axis=1)
        for interval in hits:
            low, high = interval(scores)
            hits[interval] += low <= 0 <= high
    assert hits[seed_interval] >= 180 and hits[stratified_interval] <= 120


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


def test_bootstrap_of_tasks_with_other_numbers_of_episodes():
    """Task a is always 1, task b the mean of two draws from {0, 4}: (1 + 0)/2 to (1 + 4)/2."""
    assert bootstrap([np.array([1.0]), np.array([0.0, 4.0])]) == (0.5, 2.5)
