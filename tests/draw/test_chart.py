"""Axes, marks and their places by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mpdt.draw.chart import (
    BOTTOM,
    LEFT,
    PLOT_HEIGHT,
    RIGHT,
    ROW,
    TOP,
    WIDTH,
    Axis,
    Chart,
    Dot,
    axis_over,
    band,
    line,
    row_chart,
    steps,
)
from mpdt.draw.html import environment


@pytest.mark.parametrize(
    ("axis", "texts"),
    [
        (Axis(0, 97), ["0", "25", "50", "75"]),
        (Axis(-1, 1), ["-1", "-0.5", "0", "0.5", "1"]),
        (Axis(0, 20_000), ["0", "5000", "10k", "15k", "20k"]),
        (Axis(0.5, 900, is_log=True), ["1", "10", "100"]),
        (Axis(2, 60, is_log=True), ["2", "5", "10", "20", "50"]),
        (Axis(2, 6, is_log=True), ["2", "3", "4", "5", "6"]),  # no decade: round numbers
    ],
)
def test_ticks_are_round(axis: Axis, texts: list[str]) -> None:
    assert [text for _, text in axis.ticks()] == texts


def test_a_place_on_an_axis() -> None:
    """10 lies halfway between 1 and 100 on a logarithmic one; beyond the ends is at the end."""
    assert Axis(1, 100, is_log=True).share(10) == pytest.approx(0.5)
    assert [Axis(0, 4).share(v) for v in (-9, 1, 9)] == [0.0, 0.25, 1.0]
    assert Axis(3, 3).share(3) == 0.5


@pytest.mark.parametrize(
    "values", [[], [math.nan], [7.0, 7.0], [0.0, 5e-324], [-1e308, 1e308], [math.inf, 1.0]]
)
@pytest.mark.parametrize("is_log", [False, True])
def test_whatever_a_file_holds_there_is_an_axis(values: list[float], is_log: bool) -> None:
    axis = axis_over(values, is_log=is_log)
    assert math.isfinite(axis.high - axis.low) and axis.high > axis.low
    assert all(0 <= share <= 1 for share, _ in axis.ticks())


def test_corners_of_the_plot() -> None:
    chart = Chart("t", Axis(0, 10), Axis(0, 1), (line("a", [0, 10], [0, 1]),))
    assert chart.path(chart.marks[0]) == f"{LEFT},{TOP + PLOT_HEIGHT} {WIDTH - RIGHT},{TOP}"
    assert chart.height == TOP + PLOT_HEIGHT + BOTTOM


def test_what_is_no_number_is_left_out() -> None:
    drawn = line("a", [0, 1, 2], [1.0, math.nan, 3.0])
    assert drawn.points.tolist() == [[0, 1], [2, 3]]


def test_outlines_of_histograms_and_bands() -> None:
    """Two bins of heights 3 and 1 go up, down, and back to the ground."""
    outline = steps("a", np.array([0.0, 1, 2]), np.array([3.0, 1]))
    assert outline.points.tolist() == [[0, 0], [0, 3], [1, 3], [1, 1], [2, 1], [2, 0]]
    area = band("a", np.array([0.0, 1]), np.array([1.0, 2]), np.array([3.0, 4]))
    assert area.points.tolist() == [[0, 1], [1, 2], [1, 4], [0, 3]]


def test_rows_go_down_and_bars_begin_at_zero() -> None:
    rows = [("a", [Dot("x", 2.0)]), ("b", [Dot("x", -1.0, -2.0, 0.0)]), ("c", [Dot("x", math.nan)])]
    chart = row_chart("t", rows, Axis(-2, 2), bars=True)
    first, second, whisker = chart.marks
    assert first.points.tolist() == [[0, 0.15], [2, 0.85]]
    assert second.points[1].tolist() == [-1, 1.85]
    assert whisker.points.tolist() == [[-2, 1.5], [0, 1.5]]
    assert chart.at_y(1.0) == TOP + ROW and chart.height == TOP + 3 * ROW + BOTTOM


def test_texts_of_a_picture_are_escaped() -> None:
    chart = row_chart("<t>", [("<b>&", [Dot("x", 1.0, told="<i>")])], Axis(0, 1, "<u>"))
    source = '{% from "chart.svg" import draw with context %}{{ draw(chart) }}'
    page = environment("mpdt.draw").from_string(source).render(chart=chart)
    assert "<t>" not in page and "<b>" not in page and "<i>" not in page and "<u>" not in page
    assert "&lt;b&gt;&amp;" in page and "<title>&lt;i&gt;</title>" in page
