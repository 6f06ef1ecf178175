"""Spans: so many rows behind each other from many places of a flat array, one copy for each.

    rows      0 1 2 3 4 5 6 7          count 3, first 4 and 1   ->   4 5 6 | 1 2 3

A window's rows lie side by side in the file, so one number names them all. So they do where several
files are read as one: an episode lies in one of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.slices.ahead import read_no_further
from mpdt.data.store.rows import JoinedRows

Ids = NDArray[np.int64]


class Spans:
    """`count` rows at a time from `values`: an array, a map, or rows of several files."""

    def __init__(self, values: NDArray[Any] | JoinedRows, count: int) -> None:
        self._values, self._offsets = plain(values), np.arange(count)
        parts = values.arrays if isinstance(values, JoinedRows) else [self._values]
        self._views = [_view(part, count) for part in parts]
        read_no_further(parts)

    def at(self, first: Ids) -> NDArray[Any]:
        """A copy (..., count, ...) of the rows from `first` (...) on.

        The last of the rows has to be there. What would lie outside the array, or in another
        stretch of rows than the last one does, is any row: nobody may look at it.
        """
        count, width = len(self._offsets), self._values.shape[1:]
        if isinstance(self._values, JoinedRows):
            number, last = self._values.located(first + (count - 1))
            begin = last - (count - 1)
        else:
            number, begin = None, first
        found = None
        for which, view in enumerate(self._views):
            fits = (begin >= 0) & (begin < len(view))
            if number is not None:
                fits &= number == which
            if fits.all():
                return self._rows(view[begin])
            if found is None:
                found = np.empty((*first.shape, count, *width), self._values.dtype)
                left = np.ones(first.shape, np.bool_)
            if fits.any():
                found[fits] = self._rows(view[begin[fits]])
                left &= ~fits
        assert found is not None
        if left.any():
            rows = np.clip(first[left][..., None] + self._offsets, 0, len(self._values) - 1)
            found[left] = self._values.take(rows, axis=0)
        return found

    def _rows(self, spans: NDArray[Any]) -> NDArray[Any]:
        shape = (*spans.shape, len(self._offsets), *self._values.shape[1:])
        return np.asarray(spans.view(self._values.dtype).reshape(shape))

    def row(self, at: Ids) -> NDArray[Any]:
        """A copy of single rows."""
        return np.asarray(self._values.take(at, axis=0))


def _view(values: NDArray[Any], count: int) -> NDArray[Any]:
    """Each item begins one row of the array later and is the bytes of `count` rows.

    As bytes, because numpy copies an item at once and the numbers of a row one by one.
    """
    rows = np.ascontiguousarray(values)
    size = int(np.prod(rows.shape[1:])) * rows.dtype.itemsize
    many = max(0, len(rows) - count + 1)
    return np.ndarray((many,), np.dtype((np.void, count * size)), rows, 0, (size,))


def plain(values: NDArray[Any] | JoinedRows) -> Any:
    """Without the class of a map, whose every piece is made and checked as one more map. Rows of
    several files stay what they are: as a plain array they would be a copy of them all."""
    return np.asarray(values) if isinstance(values, np.ndarray) else values
