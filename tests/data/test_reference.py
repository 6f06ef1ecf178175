"""Standard errors by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mpdt.data.reference import UNKNOWN, Reference, References, level


def test_of_three_episodes_by_hand() -> None:
    """1, 2, 6: mean 3, variance (4 + 1 + 9) / 2 = 7, error sqrt(7 / 3)."""
    found = Reference.of(np.array([1.0, 2.0, 6.0]), np.array([True, False, True]), "local")
    assert (found.mean, found.episodes, found.source) == (3.0, 3, "local")
    assert found.error == pytest.approx(math.sqrt(7 / 3))
    assert found.success == pytest.approx(2 / 3)


def test_one_episode_has_no_error_and_none_is_unknown() -> None:
    one = Reference.of(np.array([4.0]))
    assert (one.mean, one.episodes, one.success) == (4.0, 1, None) and math.isnan(one.error)
    assert Reference.of(np.array([])) == UNKNOWN and not UNKNOWN.is_known


def test_levels_by_hand() -> None:
    assert level(30.0, 10.0, 50.0) == 0.5
    assert level(0.0, 10.0, 50.0) == -0.25
    for without_scale in [(1.0, 5.0, 5.0), (1.0, 5.0, 4.0), (1.0, math.nan, 5.0)]:
        assert math.isnan(level(*without_scale))


def test_what_is_not_there_is_unknown() -> None:
    references = References({"zero": Reference(0.0, 0.0, 4)})
    assert references["zero"].is_known and references["expert"] is UNKNOWN
