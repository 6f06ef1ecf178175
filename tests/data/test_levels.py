"""Levels by hand: random 10, expert 110, so medium 60 has level 0.5."""

from __future__ import annotations

import math

import pytest

from mpdt.data.levels import TaskLevels

NAN = float("nan")


def levels(random: float, medium: float, expert: float) -> TaskLevels:
    return TaskLevels("t", zero=0.0, random=random, medium=medium, expert=expert, history=NAN)


def test_level_of_medium() -> None:
    assert levels(10, 60, 110).medium_level == 0.5
    assert levels(-100, -50, 300).medium_level == 0.125
    assert math.isnan(levels(5, 5, 5).medium_level)


@pytest.mark.parametrize(
    ("returns", "text"),
    [
        ((10, 60, 110), ""),
        ((10, 45, 110), ""),  # level 0.35, the edge
        ((10, 75, 110), ""),  # level 0.65, the edge
        ((10, 44, 110), "level 0.34"),
        ((10, 76, 110), "level 0.66"),
        ((10, 120, 110), "not between random 10.0 and expert 110.0"),
        ((10, 5, 110), "not between"),
        ((10, 10, 110), "not between"),
        ((10, 60, 10), "expert 10.0 is not above random 10.0"),
        ((10, NAN, 110), ""),  # no medium asked for
        ((10, NAN, 9), "not above"),
    ],
)
def test_faults(returns: tuple[float, float, float], text: str) -> None:
    found = levels(*returns).faults()
    assert (text in found[0] and found[0].startswith("t: ")) if text else found == []
