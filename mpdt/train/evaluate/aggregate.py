"""Many runs in one number: interquartile mean, and an interval that resamples runs.

    scores (R, N)    R training seeds of N tasks
    seed means       runs that share a training seed are averaged before anything else
    IQM              mean of the middle half of all R x N scores
    stratified       runs are drawn with replacement inside every task, 2000 times
    seeds            Student's t over the R means: what verdicts rest on
    profile          share of all R x N scores above a number
    improvement      chance that a run of one method beats a run of another on a task

The stratified interval takes the tasks of a run for independent. They are not: one set of weights
acts in all of them, and a bad seed is bad everywhere. With 3 seeds and 5 tasks it covers the truth
in 85 % of cases if seeds share nothing and in 44 % if they share most; t covers 95 % in both.

Source: Agarwal et al. 2021, "Deep RL at the Edge of the Statistical Precipice", section 4; the
same definitions as their package rliable (which brings eighteen others along; compared with it in
tests/train/evaluate/test_rliable.py).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.seeding import generator_of

RESAMPLES = 2000
Statistic = Callable[[NDArray[Any]], float]


def iqm(scores: NDArray[Any]) -> float:
    """Mean without the lowest and the highest quarter, each rounded down.

    1 2 3 4 100  ->  a quarter of 5 is 1 score:  (2 + 3 + 4) / 3 = 3
    """
    ordered = np.sort(np.asarray(scores, np.float64), axis=None)
    cut = len(ordered) // 4
    return float(ordered[cut : len(ordered) - cut].mean())


def mean(scores: NDArray[Any]) -> float:
    return float(np.mean(scores))


def seed_means(runs: Iterable[tuple[Hashable, Any]]) -> NDArray[np.float64]:
    """(R, ...): of R training seeds the mean of their runs, in the order in which seeds come.

    Runs of one training seed differ in the seed of their trials and are not independent.

        (0, 2) (0, 4) (1, 7)  ->  3 7

    Args:
        runs: (seed, number or array) of each run, all of one shape.
    """
    by_seed: dict[Hashable, list[Any]] = {}
    for seed, values in runs:
        by_seed.setdefault(seed, []).append(values)
    return np.array([np.mean(own, axis=0) for own in by_seed.values()], np.float64)


def seed_interval(scores: NDArray[Any]) -> tuple[float, float]:
    """95 % interval of the mean over seeds: m -+ t(R - 1) s / sqrt(R) of the R means of rows.

    R = 3, means 0 1 2  ->  1 -+ 4.303 * 1 / sqrt(3): (-1.48, 3.48)

    Raises: ValueError for fewer than two rows, which know nothing of other seeds.
    """
    from scipy.stats import t

    means = np.asarray(scores, np.float64).mean(axis=1)
    if len(means) < 2:
        raise ValueError("one seed has no interval over seeds")
    reach = float(t.ppf(0.975, len(means) - 1) * means.std(ddof=1) / len(means) ** 0.5)
    return float(means.mean()) - reach, float(means.mean()) + reach


def stratified_interval(
    scores: NDArray[Any], statistic: Statistic = iqm, seed: int = 0
) -> tuple[float, float]:
    """95 % percentile interval of `statistic` over scores (R, N); every task keeps R runs."""
    draws = generator_of(seed)
    runs, tasks = scores.shape
    picks = draws.integers(runs, size=(RESAMPLES, runs, tasks))
    drawn = np.take_along_axis(scores[None], picks, axis=1)
    low, high = np.quantile([statistic(each) for each in drawn], [0.025, 0.975])
    return float(low), float(high)


def profile(scores: NDArray[Any], at: NDArray[Any]) -> NDArray[np.float64]:
    """Share of the scores above each number of `at`, (K,): Agarwal et al., section 4.2.

    0 1 1 3 at 0, 1, 2  ->  3/4 1/4 1/4
    """
    flat = np.asarray(scores, np.float64).reshape(-1, 1)
    share: NDArray[np.float64] = (flat > np.asarray(at, np.float64)).mean(axis=0)
    return share


def improvement(ours: NDArray[Any], theirs: NDArray[Any]) -> float:
    """P(X > Y) + P(X = Y) / 2 of a run X of ours and Y of theirs on one task; mean over tasks.

    Ours 1 2, theirs 1 on one task  ->  (1/2 + 1) / 2 = 0.75

    Args:
        ours, theirs: (R, N) and (R', N) of the same N tasks, whatever R and R'.
    """
    x, y = (np.asarray(scores, np.float64) for scores in (ours, theirs))
    if x.shape[1] != y.shape[1]:
        raise ValueError(f"other tasks: {x.shape[1]} and {y.shape[1]}")
    pairs = x[:, None] - y[None]
    return float(((pairs > 0) + 0.5 * (pairs == 0)).mean())


def goal_means(returns: NDArray[np.float64], goals: int) -> NDArray[np.float64]:
    """Means (n, min(E, goals)) of returns (n, E) where episode e has goal e modulo `goals`.

    A policy that does not draw lives a goal through in the same way each time: five goals ten times
    are five episodes, and an interval over fifty would be three times too narrow.
    """
    E = returns.shape[1]
    return np.stack([returns[:, at::goals].mean(axis=1) for at in range(min(E, goals))], axis=1)


def bootstrap(
    values: Sequence[NDArray[np.float64]] | NDArray[np.float64], seed: int = 0
) -> tuple[float, float]:
    """95 % interval of the mean over tasks of the mean over seeds; one array (E,) per task.

    Seeds are resampled inside each task. Source: Efron & Tibshirani 1993, chapter 13
    (percentile interval); too narrow for a handful of seeds, and honest about ties.
    """
    draws = generator_of(seed)
    means = np.zeros(RESAMPLES)
    for own in values:
        picks = draws.integers(len(own), size=(RESAMPLES, len(own)))
        means += own[picks].mean(axis=1) / len(values)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)
