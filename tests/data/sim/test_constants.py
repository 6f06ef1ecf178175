"""The choice of the constant action from a small table, by hand."""

from __future__ import annotations

import numpy as np

from mpdt.data.sim.constants import choose_constant, constant_actions
from mpdt.data.sim.record import constant_names


def test_candidates_by_hand() -> None:
    assert constant_actions(2).tolist() == [[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]]
    assert constant_names(2) == ["zero", "constant+0", "constant+1", "constant-0", "constant-1"]


def test_the_choice_goes_by_levels_and_not_by_returns() -> None:
    """Task a spans 0 to 10, task b 100 to 1100.

    returns     a    b       levels       mean
    zero        0    100     0     0      0
    +           8    100     0.8   0      0.4      best
    -           0    700     0     0.6    0.3      best by plain returns
    """
    returns = np.array([[0.0, 8.0, 0.0], [100.0, 100.0, 700.0]])
    assert choose_constant(returns, np.array([0.0, 100.0]), np.array([10.0, 1100.0])) == 1
    assert returns.mean(axis=0).argmax() == 2


def test_of_equal_candidates_the_first() -> None:
    returns = np.array([[0.0, 3.0, 3.0]])
    assert choose_constant(returns, np.zeros(1), np.ones(1)) == 1


def test_no_choice_without_levels() -> None:
    """No training task; an expert nobody measured; an expert that is as good as random."""
    one = np.ones((1, 3))
    assert choose_constant(np.array([]), np.array([]), np.array([])) is None
    assert choose_constant(one, np.zeros(1), np.array([np.nan])) is None
    assert choose_constant(one, np.zeros(1), np.zeros(1)) is None
