"""Spans: so many rows behind each other from many places of a flat array, one copy for each.

    rows      0 1 2 3 4 5 6 7          count 3, first 4 and 1   ->   4 5 6 | 1 2 3

A window's rows lie side by side in the file, so one number names them all.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Ids = NDArray[np.int64]


class Spans:
    """`count` rows at a time from `values`: an array, a map, or rows of several files."""

    def __init__(self, values: NDArray[Any], count: int) -> None:
        self._values, self._offsets = plain(values), np.arange(count)
        self._last = len(values) - count
        self._view: NDArray[Any] | None = None
        if isinstance(self._values, np.ndarray) and self._last >= 0:
            rows = np.ascontiguousarray(self._values)
            width = int(np.prod(rows.shape[1:]))
            step = rows.dtype.itemsize
            # Each row of the view begins one row of the array later, and is `count` of them long.
            self._view = np.ndarray(
                (self._last + 1, count * width), rows.dtype, rows, 0, (width * step, step)
            )

    def at(self, first: Ids) -> NDArray[Any]:
        """A copy (..., count, ...) of the rows from `first` (...) on.

        What would lie outside the array is any of its rows: nobody may look at it.
        """
        if self._view is not None and int(first.min()) >= 0 and int(first.max()) <= self._last:
            shape = (*first.shape, len(self._offsets), *self._values.shape[1:])
            return self._view[first].reshape(shape)
        rows = np.clip(first[..., None] + self._offsets, 0, len(self._values) - 1)
        return np.asarray(self._values.take(rows, axis=0))

    def row(self, at: Ids) -> NDArray[Any]:
        """A copy of single rows."""
        return self._values.take(at, axis=0)


def plain(values: NDArray[Any]) -> NDArray[Any]:
    """Without the class of a map, whose every piece is made and checked as one more map. Rows of
    several files stay what they are: as a plain array they would be a copy of them all."""
    return np.asarray(values) if isinstance(values, np.ndarray) else values
