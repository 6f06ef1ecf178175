"""Rows of several arrays, read as one array: nothing is copied before it is asked for.

    joined    0 1 2 | 3 4 | 5 6 7         runs of neighbours, each in one of the arrays
    array     a     | b   | a
    row       4 5 6 | 0 1 | 7 8 9

What a file's map does: rows that lie in one run are a view, everything else is a fresh copy.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.store.tables import Int64


class JoinedRows:
    """Reads like an array of shape (rows, ...) that nobody may write to.

    Args:
        arrays: equal but for their number of rows, such as maps of files.
        number, first, count: (E,) for stretches one after another: which array, its first row
            there, how many rows.
    """

    def __init__(
        self, arrays: Sequence[NDArray[Any]], number: Int64, first: Int64, count: Int64
    ) -> None:
        # Plain arrays: every piece of a memmap would be one more memmap.
        self.arrays = [np.asarray(array) for array in arrays]
        number, first, count = (np.asarray(one, np.int64) for one in (number, first, count))
        number, first, count = (one[count > 0] for one in (number, first, count))
        begins = np.ones(len(count), np.bool_)
        begins[1:] = (number[1:] != number[:-1]) | (first[1:] != first[:-1] + count[:-1])
        starts = np.cumsum(count) - count
        self._starts = starts[begins]
        self._number, self._first = number[begins], first[begins]
        self.shape = (int(count.sum()), *self.arrays[0].shape[1:])
        self.dtype = self.arrays[0].dtype
        self.ndim = len(self.shape)

    def __len__(self) -> int:
        return int(self.shape[0])

    def located(self, rows: Int64) -> tuple[Int64, Int64]:
        """In which of `arrays` rows lie, and at which of its rows; in any shape."""
        run = np.searchsorted(self._starts, rows, side="right") - 1
        return self._number[run], rows - self._starts[run] + self._first[run]

    def take(self, rows: Any, axis: int = 0) -> NDArray[Any]:
        """A copy of rows by number, in any shape. Raises: IndexError."""
        at = np.asarray(rows, np.int64)
        if axis != 0:
            raise IndexError("only rows can be taken")
        if at.size and (int(at.min()) < -len(self) or int(at.max()) >= len(self)):
            raise IndexError(f"row outside 0 to {len(self) - 1}")
        at = np.where(at < 0, at + len(self), at)
        found = np.empty((*at.shape, *self.shape[1:]), self.dtype)
        if not at.size:
            return found
        number, at = self.located(at)
        for which, array in enumerate(self.arrays):
            here = number == which
            if here.all():
                return array.take(at, axis=0)
            if here.any():
                found[here] = array.take(at[here], axis=0)
        return found

    def __getitem__(self, key: Any) -> NDArray[Any]:
        rows, *rest = key if isinstance(key, tuple) else (key,)
        if rows is Ellipsis:
            return self[:]
        if isinstance(rows, slice):
            start, stop, step = rows.indices(len(self))
            if step == 1:
                return self._span(start, max(start, stop), rest)
            rows = np.arange(start, stop, step)
        elif isinstance(rows, np.ndarray) and rows.dtype == np.bool_:
            rows = np.flatnonzero(rows)
        found = self.take(rows)
        return np.asarray(found[(slice(None),) * np.ndim(rows) + tuple(rest)] if rest else found)

    def _span(self, start: int, stop: int, rest: list[Any]) -> NDArray[Any]:
        """Rows in a row, of each run no more than is asked for."""
        ends = np.r_[self._starts[1:], len(self)]
        first = int(np.searchsorted(self._starts, start, side="right")) - 1
        last = int(np.searchsorted(self._starts, stop, side="left"))
        pieces = []
        for run in range(max(first, 0), last):
            low, high = max(start, int(self._starts[run])), min(stop, int(ends[run]))
            shift = int(self._first[run] - self._starts[run])
            rows = (slice(low + shift, high + shift), *rest)
            pieces.append(self.arrays[int(self._number[run])][rows])
        if not pieces:
            return self.arrays[0][(slice(0, 0), *rest)]
        return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("rows of several files are one array only as a copy")
        return np.array(self[:], dtype)
