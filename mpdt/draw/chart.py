"""Chart: lines, areas and bars between two axes, laid out here and drawn by templates/chart.svg.

    Chart("returns", Axis(0, 10, "return"), Axis(0, 1, "share"), (line("expert", x, y),))

A picture is 340 units wide, about what a phone shows, so that its text keeps its size there.
Colours are CSS classes (`k-expert`), so that one picture serves light and dark.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

WIDTH = 340
PLOT_HEIGHT = 150
TOP, RIGHT, BOTTOM, LEFT = 8, 18, 34, 56
ROW = 15  # height of one row of a chart of rows
LETTER = 6.2  # width of a letter of row names, roughly
NAME = 22  # letters of a row name that are shown on a phone; the rest when pointed at
LARGEST = 1e300  # files may hold anything; the span of an axis stays finite

Floats = npt.NDArray[np.float64]
Numbers = Sequence[float] | Floats


@dataclass(frozen=True)
class Axis:
    """A range of numbers, linear or logarithmic. Numbers outside stand at its ends."""

    low: float
    high: float
    label: str = ""
    is_log: bool = False

    def share(self, number: float) -> float:
        """Place of `number` between low (0) and high (1)."""
        low, high, at = self.low, self.high, min(max(number, self.low), self.high)
        if self.is_log:
            low, high, at = math.log(low), math.log(high), math.log(at)
        return (at - low) / (high - low) if high > low else 0.5

    def ticks(self) -> list[tuple[float, str]]:
        """Three to six round numbers as (share, text)."""
        numbers = _powers(self.low, self.high) if self.is_log else _round(self.low, self.high)
        return [(self.share(number), _text(number)) for number in numbers]


def axis_over(values: Iterable[float], label: str = "", is_log: bool = False) -> Axis:
    """An axis that holds the finite ones of `values` (on a log axis: the positive ones)."""
    known = [min(max(v, -LARGEST), LARGEST) for v in values if math.isfinite(v)]
    known = [v for v in known if v > 1 / LARGEST or not is_log]
    low, high = (min(known), max(known)) if known else (1.0, 10.0)
    if high - low < max(1e-100, 1e-9 * max(abs(low), abs(high))):
        margin = max(0.5, 1e-6 * abs(low))
        low, high = (low / 2, high * 2) if is_log else (low - margin, high + margin)
    return Axis(low, high, label, is_log)


def _round(low: float, high: float) -> list[float]:
    """Multiples of 1, 2, 2.5 or 5 times a power of ten.    0, 97 -> 0 25 50 75"""
    rough = (high - low) / 4
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * m for m in (1, 2, 2.5, 5, 10) if power * m >= rough * 0.999)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [k * step for k in range(first, last + 1)]


def _powers(low: float, high: float) -> list[float]:
    """1, 2 and 5 times powers of ten; over more than two decades the powers alone.

    Within one decade they would be too few, and round numbers stand instead.
    """
    if high / low < 10:
        return _round(low, high)
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    factors = (1,) if math.log10(high / low) > 2 else (1, 2, 5)
    every = max(1, round((last - first) / 5))
    found = [m * 10.0**k for k in range(first, last + 1, every) for m in factors]
    return [number for number in found if low * 0.999 <= number <= high * 1.001]


def _text(number: float) -> str:
    if abs(number) >= 10_000:
        return f"{number / 1000:,.4g}k"
    text = f"{number:.4g}"
    return "0" if text == "-0" else text


@dataclass(frozen=True)
class Mark:
    """Something drawn: an area, a line or whisker through points, dots, a box, a bar.

    Args:
        key: CSS class `k-<key>` gives the colour.
        points: (n, 2) in the chart's own numbers; box and bar have two corners.
        told: shown when pointed at.
    """

    kind: Literal["area", "line", "dots", "bar", "rule"]
    key: str
    points: Floats
    told: str = ""


def line(key: str, x: Numbers, y: Numbers, told: str = "") -> Mark:
    return Mark("line", key, _finite(x, y), told)


def band(key: str, x: Floats, low: Floats, high: Floats) -> Mark:
    """The area between two lines."""
    return Mark("area", key, _finite(np.r_[x, x[::-1]], np.r_[low, high[::-1]]))


def rule(key: str, x: float, told: str) -> Mark:
    """A line across the chart at x."""
    return Mark("rule", key, np.array([[x, 0.0]]), told)


def steps(key: str, edges: Floats, heights: Floats, told: str = "") -> Mark:
    """The outline of a histogram: (n + 1,) edges, (n,) heights."""
    x, y = np.repeat(edges, 2), np.r_[0.0, np.repeat(heights, 2), 0.0]
    return Mark("area", key, _finite(x, y), told)


def _finite(x: Numbers, y: Numbers) -> Floats:
    points = np.stack([np.asarray(x, np.float64), np.asarray(y, np.float64)], axis=1)
    return points[np.isfinite(points).all(axis=1)]


@dataclass(frozen=True)
class Chart:
    """Marks between two axes."""

    title: str
    x: Axis
    y: Axis
    marks: tuple[Mark, ...]
    row_names: tuple[str, ...] = ()
    """From top to bottom, instead of ticks of the y axis: row i is y from i to i + 1."""
    width: float = WIDTH
    letters: int = NAME
    """Of a row name that are shown."""

    @property
    def left(self) -> float:
        if not self.row_names:
            return LEFT
        return 14 + LETTER * min(self.letters, max(map(len, self.row_names)))

    @property
    def bottom(self) -> float:
        """Where the plot ends and the text below begins."""
        return TOP + (ROW * len(self.row_names) if self.row_names else PLOT_HEIGHT)

    @property
    def height(self) -> float:
        return self.bottom + BOTTOM

    def at_x(self, number: float) -> float:
        return round(self.left + self.x.share(number) * (self.width - RIGHT - self.left), 1)

    def at_y(self, number: float) -> float:
        share = self.y.share(number)
        return round(TOP + (share if self.row_names else 1 - share) * (self.bottom - TOP), 1)

    def path(self, mark: Mark) -> str:
        """`x,y x,y ...` in units of the picture."""
        return " ".join(f"{self.at_x(x):g},{self.at_y(y):g}" for x, y in mark.points.tolist())

    def x_ticks(self) -> list[tuple[float, str]]:
        span = self.width - RIGHT - self.left
        return [(round(self.left + share * span, 1), text) for share, text in self.x.ticks()]

    def y_ticks(self) -> list[tuple[float, str]]:
        """Place and text; of a chart of rows the middle of each row and its name."""
        if self.row_names:
            return [(TOP + ROW * (i + 0.5), name) for i, name in enumerate(self.row_names)]
        plot = self.bottom - TOP
        return [(round(self.bottom - share * plot, 1), text) for share, text in self.y.ticks()]


@dataclass(frozen=True)
class Dot:
    """A value in a row, with its interval where one is known."""

    key: str
    value: float
    low: float = math.nan
    high: float = math.nan
    told: str = ""


def row_chart(
    title: str, rows: Sequence[tuple[str, Sequence[Dot]]], x: Axis, bars: bool = False
) -> Chart:
    """Named rows of dots, or with `bars` of bars from zero."""
    marks = []
    for i, (_, dots) in enumerate(rows):
        for dot in dots:
            if not math.isfinite(dot.value):
                continue
            if bars:
                corners = np.array([[0.0, i + 0.15], [dot.value, i + 0.85]])
                marks.append(Mark("bar", dot.key, corners, dot.told))
            if math.isfinite(dot.low + dot.high):
                ends = np.array([[dot.low, i + 0.5], [dot.high, i + 0.5]])
                marks.append(Mark("line", "whisker" if bars else dot.key, ends, dot.told))
            if not bars:
                marks.append(Mark("dots", dot.key, np.array([[dot.value, i + 0.5]]), dot.told))
    names = tuple(name for name, _ in rows)
    return Chart(title, x, Axis(0.0, float(max(1, len(rows)))), tuple(marks), names)
