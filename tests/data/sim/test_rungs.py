"""Rungs chosen from curves worked out by hand."""

from __future__ import annotations

import numpy as np

from mpdt.data.sim.rungs import choose_rungs, judge
from mpdt.data.spec.tasks import get_family


def test_rungs_cover_every_task_at_half_level() -> None:
    """Task 0 passes one half at snapshot 1, task 1 at snapshot 3: both must be kept."""
    levels = np.array([[0.0, 0.0], [0.5, 0.1], [0.8, 0.2], [0.9, 0.5], [1.0, 0.9], [1.0, 1.0]])
    assert choose_rungs(levels, 4) == [0, 1, 3, 5]


def test_rungs_are_even_where_nothing_is_forced() -> None:
    """One task, levels 0, .1 .. 1: one rung near one half, no wide gap."""
    levels = np.linspace(0, 1, 11)[:, None]
    chosen = choose_rungs(levels, 5)
    assert chosen[0] == 0 and chosen[-1] == 10 and {4, 5, 6} & set(chosen)
    assert len(chosen) == 5
    assert max(np.diff(chosen)) <= 3


def test_a_gap_in_the_curve_does_not_eat_the_rungs() -> None:
    """Nothing lies between 0 and .6; the six rungs still reach evenly up to 1."""
    levels = np.array([0.0, 0.6, 0.61, 0.62, 0.63, 0.64, 0.7, 0.8, 0.9, 1.0])[:, None]
    assert choose_rungs(levels, 6) == [0, 1, 6, 7, 8, 9]


def test_all_snapshots_are_rungs_when_there_are_few() -> None:
    assert choose_rungs(np.zeros((3, 2)), 20) == [0, 1, 2]


def test_uniform_actions_return_what_was_published() -> None:
    """Random actions over 200 steps: about -36 forward and -4 backward."""
    forward, backward = judge(get_family("cheetah_dir"), None, 16, 0.0, seed=0, threads=1)
    assert -50 < forward < -22
    assert -18 < backward < 10


def test_uniform_actions_are_judged_as_they_always_were() -> None:
    """Numbers from before judging shared its loop with collecting."""
    found = judge(get_family("cheetah_dir"), None, 2, 0.1, 0, 1)
    np.testing.assert_allclose(found, [-24.379321837198603, 38.72880659535947], rtol=1e-9)
