"""Statistics of long columns in two passes: to the bit what numpy says of a column in memory.

    rows of the map     |-- leaf --|-- leaf --|-- leaf --| ...     some megabytes each, in threads
    pass 1, each leaf   sum, min, max, and how many numbers of a column begin with which 16 bits
    pass 2, each leaf   squares around the mean; the other 16 bits of those numbers among which
                        a quantile lies
    leaves together     sums as numpy adds them: halves of halves, which are the leaves

Memory does not grow with the number of rows, and a file that does not fit is read twice. A column
whose quantile may be 0.0 or -0.0 is asked of numpy whole (`whole_column`, the slow twin): which of
them it then finds is up to how it sorts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.store.layout import STATS
from mpdt.data.store.tables import Float64, Int64
from mpdt.data.workers.threads import in_order

QUANTILES = {name: int(name[1:]) / 100 for name in STATS if name.startswith("q")}
LEAF_ROWS = 1 << 14
"""At most so many rows at a time; 39 columns of them are 2.5 MB."""

_BINS = 1 << 16
_ORDER = np.concatenate([np.arange(_BINS - 1, _BINS // 2 - 1, -1), np.arange(_BINS // 2)])
"""The upper 16 bits of float32 numbers, from the least to the greatest: negative ones fall."""
_NEGATIVE_ZERO = np.uint32(1 << 31)
_ZERO = np.float32(0)
"""Added it leaves one kind of zero; numpy's sort makes of two kinds any number of each."""

_quiet = np.errstate(invalid="ignore")  # of infinite numbers; threads do not inherit the caller's
Runs = Sequence[tuple[int, int]]
Bits = NDArray[np.uint16]


def table_of(array: NDArray[Any], runs: Runs, leaf_rows: int = LEAF_ROWS) -> dict[str, Float64]:
    """Statistic -> (C,) float64, over the rows `runs` of an array (N,) or (N, C).

    Quantiles interpolate linearly between the two nearest rows, `std` is the population's. NaN
    where a column has one.

    Args:
        runs: first row and the one behind the last, ascending, at least one row in all.
    """
    width = 1 if array.ndim == 1 else array.shape[1]
    if array.dtype != np.float32:
        columns = [whole_column(_gather(array, runs, column)) for column in range(width)]
        return _side_by_side(columns)
    rows = _Rows(array, runs)
    first = _first_pass(rows, width, leaf_rows)
    table = {"count": np.full(width, float(rows.count)), "mean": first.sums / rows.count,
             "min": first.lows, "max": first.highs}  # fmt: skip
    squares, ranked = _second_pass(rows, first, table["mean"], leaf_rows)
    table["std"] = np.sqrt(squares / rows.count)
    table |= ranked
    zeros = np.any([table[name] == 0 for name in ("min", "max", *QUANTILES)], axis=0)
    for column in np.flatnonzero(zeros & first.has_negative_zero).tolist():
        for name, value in whole_column(_gather(array, runs, column)).items():
            table[name][column] = value
    return {name: table[name] for name in STATS}


def whole_column(row: Float64) -> dict[str, float]:
    """Every statistic of one column that lies in memory, as numpy has them."""
    found = {"count": float(len(row)), "mean": row.mean(), "min": row.min(), "max": row.max()}
    found |= zip(QUANTILES, np.quantile(row, list(QUANTILES.values())).tolist(), strict=True)
    found["std"] = np.sqrt(np.square(row - found["mean"]).mean())
    return {name: float(found[name]) for name in STATS}


def _side_by_side(columns: Sequence[dict[str, float]]) -> dict[str, Float64]:
    return {name: np.array([one[name] for one in columns]) for name in STATS}


def _gather(array: NDArray[Any], runs: Runs, column: int) -> Float64:
    flat = array if array.ndim == 1 else array[:, column]
    return np.concatenate([flat[start:stop] for start, stop in runs]).astype(np.float64)


class _Rows:
    """The rows of all runs as if they lay one behind the other."""

    def __init__(self, array: NDArray[Any], runs: Runs) -> None:
        self._array = array if array.ndim == 2 else array[:, None]
        self._starts = np.array([start for start, _ in runs])
        self._ends = np.cumsum([stop - start for start, stop in runs])
        self.count = int(self._ends[-1])

    def columns(self, begin: int, end: int) -> NDArray[np.float32]:
        """(C, end - begin): each column of these rows as one stretch of memory."""
        first = int(np.searchsorted(self._ends, begin, side="right"))
        pieces, at = [], begin
        for run in range(first, len(self._ends)):
            stop = min(end, int(self._ends[run]))
            skipped = int(self._ends[run - 1]) if run else 0
            start = int(self._starts[run]) + at - skipped
            pieces.append(self._array[start : start + stop - at])
            at = stop
            if at == end:
                break
        block = pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
        return np.ascontiguousarray(block.T)


@dataclass(frozen=True)
class _First:
    """What the first pass found; shapes (C,) but for `counts` (C, 65536) or `ranked`.

    Args:
        counts: of each column's numbers, by their upper 16 bits; None where one leaf has all rows.
        ranked: that leaf, each column sorted.
    """

    sums: Float64
    lows: Float64
    highs: Float64
    has_negative_zero: NDArray[np.bool_]
    counts: NDArray[np.int64] | None = None
    ranked: NDArray[np.float32] | None = None


def _half(count: int, most: int) -> int:
    """Where numpy's pairwise sum halves a contiguous column; 0 where it, or we, halve no more."""
    return 0 if count <= max(most, 128) else count // 2 - count // 2 % 8


def _leaves(begin: int, end: int, most: int) -> Iterator[tuple[int, int]]:
    """Rows that are added among themselves."""
    half = _half(end - begin, most)
    if not half:
        yield begin, end
    else:
        yield from _leaves(begin, begin + half, most)
        yield from _leaves(begin + half, end, most)


def _added(sums: Iterator[Float64], count: int, most: int) -> Float64:
    """Sums of leaves, in their order, added as `_leaves` halved them."""
    half = _half(count, most)
    if not half:
        return next(sums)
    left = _added(sums, half, most)
    return left + _added(sums, count - half, most)


def _first_pass(rows: _Rows, width: int, leaf_rows: int) -> _First:
    leaves = list(_leaves(0, rows.count, leaf_rows))
    sums, lows, highs, negative = [], [], [], np.zeros(width, np.bool_)
    counts = np.zeros((width, _BINS), np.int64) if len(leaves) > 1 else None
    ranked = None

    @_quiet
    def look(leaf: tuple[int, int]) -> tuple[Any, ...]:
        block = rows.columns(*leaf)
        found = (block.astype(np.float64).sum(axis=1), block.min(axis=1), block.max(axis=1),
                 (block.view(np.uint32) == _NEGATIVE_ZERO).any(axis=1))  # fmt: skip
        ranks = np.sort(block + _ZERO, axis=1)
        return *found, ranks if counts is None else [_bins(row) for row in ranks]

    for total, low, high, has_negative, bins in in_order(look, leaves, int(len(leaves) == 1)):
        sums.append(total)
        lows.append(low)
        highs.append(high)
        negative |= has_negative
        if counts is None:
            ranked = bins
        else:
            for column, (upper, number) in enumerate(bins):
                np.add.at(counts[column], upper, number)
    return _First(_added(iter(sums), rows.count, leaf_rows), np.min(lows, axis=0).astype(float),
                  np.max(highs, axis=0).astype(float), negative, counts, ranked)  # fmt: skip


def _bins(row: NDArray[np.float32]) -> tuple[Bits, Int64]:
    """Which upper 16 bits a sorted row has, and how often; that of NaN maybe twice."""
    upper = np.ascontiguousarray(_halves(row)[1])
    ends = np.append(np.flatnonzero(upper[1:] != upper[:-1]), len(upper) - 1)
    return upper[ends], np.diff(ends, prepend=-1)


def _halves(row: NDArray[np.float32]) -> tuple[Bits, Bits]:
    """The lower and the upper 16 bits of each number, as views."""
    halves = row.view("<u2")
    return halves[::2], halves[1::2]


class _Lows:
    """The lower halves of the numbers with one upper half; many of them are only counted."""

    def __init__(self) -> None:
        self._waiting: list[Bits] = []
        self._num_waiting = 0
        self._counts: NDArray[np.int64] | None = None

    def add(self, lows: Bits) -> None:
        self._waiting.append(lows)
        self._num_waiting += len(lows)
        if self._num_waiting > _BINS:
            self._count()

    def _count(self) -> None:
        found = np.bincount(np.concatenate(self._waiting), minlength=_BINS)
        self._counts = found if self._counts is None else self._counts + found
        self._waiting, self._num_waiting = [], 0

    def at(self, rank: int, falling: bool) -> int:
        """The one at `rank` in order of the numbers; `falling` where those are negative."""
        if self._counts is None:
            ranked = np.sort(np.concatenate(self._waiting))
            return int(ranked[len(ranked) - 1 - rank if falling else rank])
        if self._waiting:
            self._count()
        counts = self._counts[::-1] if falling else self._counts
        low = int(np.searchsorted(np.cumsum(counts), rank, side="right"))
        return _BINS - 1 - low if falling else low


def _second_pass(
    rows: _Rows, first: _First, mean: Float64, leaf_rows: int
) -> tuple[Float64, dict[str, Float64]]:
    """Sums of squares around the mean (C,), and quantile -> (C,)."""
    width, ranks = len(mean), _ranks(rows.count)
    places = {} if first.counts is None else {
        (column, rank): _place(first.counts[column], rank)
        for column in range(width) for rank in ranks
    }  # fmt: skip
    wanted: list[list[int]] = [
        sorted({place[0] for (at, _), place in places.items() if at == column})
        for column in range(width)
    ]
    lows = {(column, upper): _Lows() for column in range(width) for upper in wanted[column]}

    @_quiet
    def look(leaf: tuple[int, int]) -> tuple[Float64, list[list[Bits]]]:
        block = rows.columns(*leaf)
        found = []
        for row, some in zip(block + _ZERO, wanted, strict=True):
            lower, upper = _halves(row)
            upper = np.ascontiguousarray(upper)
            found.append([lower[np.flatnonzero(upper == one)] for one in some])
        away = block.astype(np.float64)
        away -= mean[:, None]
        np.square(away, out=away)
        return away.sum(axis=1), found

    leaves, squares = list(_leaves(0, rows.count, leaf_rows)), []
    for total, found in in_order(look, leaves, int(len(leaves) == 1)):
        squares.append(total)
        for column, some in enumerate(found):
            for upper, lower in zip(wanted[column], some, strict=True):
                lows[column, upper].add(lower)

    def number(column: int, rank: int) -> float:
        if first.ranked is not None:
            return float(first.ranked[column, rank])
        upper, before = places[column, rank]
        bits = upper << 16 | lows[column, upper].at(rank - before, falling=upper >= _BINS // 2)
        return float(np.array([bits], np.uint32).view(np.float32)[0])

    quantiles = _between(number, width, rows.count)
    for values in quantiles.values():
        values[np.isnan(first.highs)] = np.nan
    return _added(iter(squares), rows.count, leaf_rows), quantiles


def _ranks(count: int) -> list[int]:
    """The rows of a sorted column between which the quantiles lie."""
    below = [int((count - 1) * share) for share in QUANTILES.values()]
    return sorted({min(rank + more, count - 1) for rank in below for more in (0, 1)})


def _place(counts: NDArray[np.int64], rank: int) -> tuple[int, int]:
    """Upper half of the number at `rank`, and how many numbers lie below that half."""
    ends = np.cumsum(counts[_ORDER])
    place = int(np.searchsorted(ends, rank, side="right"))
    return int(_ORDER[place]), int(ends[place] - counts[_ORDER[place]])


@_quiet
def _between(number: Callable[[int, int], float], width: int, count: int) -> dict[str, Float64]:
    """Quantiles as numpy interpolates them, from whichever of the two rows is nearer."""
    table = {}
    for name, share in QUANTILES.items():
        at = (count - 1) * share
        rank = int(at)
        weight = at - rank
        low = np.array([number(column, rank) for column in range(width)])
        high = np.array([number(column, min(rank + 1, count - 1)) for column in range(width)])
        step = high - low
        table[name] = high - step * (1 - weight) if weight >= 0.5 else low + step * weight
    return table
