"""Spans: the bytes of rows taken one by one, from one array and from rows of several."""

from __future__ import annotations

import numpy as np
import pytest

from mpdt.data.slices.spans import Spans
from mpdt.data.store.rows import JoinedRows


def rows_of(episodes: list[tuple[int, int, int]]) -> JoinedRows:
    """(array, first row there, how many) of stretches in two arrays of 12 and 9 rows."""
    generator = np.random.default_rng(0)
    arrays = [generator.standard_normal((n, 3)).astype(np.float32) for n in (12, 9)]
    number, first, count = map(np.array, zip(*episodes, strict=True))
    return JoinedRows(arrays, number, first, count)


# Neighbours of one array, a change of array, a stretch that begins where its array does.
STRETCHES = [(0, 4, 3), (0, 7, 5), (1, 0, 4), (0, 0, 4), (1, 4, 5)]
ENDS = np.cumsum([count for *_, count in STRETCHES])


@pytest.mark.parametrize("count", [1, 2, 4, 30])
def test_spans_are_the_rows_one_by_one_up_to_the_last(count: int) -> None:
    joined = rows_of(STRETCHES)
    whole = np.array(joined)
    last = np.random.default_rng(1).permuted(np.arange(len(whole)).repeat(2)).reshape(2, -1)
    for values in (joined, whole, whole[:, 0]):
        found = Spans(values, count).at(last - (count - 1))
        assert found.shape == (*last.shape, count, *whole.shape[1:][: values.ndim - 1])
        assert found.flags.c_contiguous and found.flags.writeable
        for place in np.ndindex(last.shape):
            stretch = np.searchsorted(ENDS, last[place], side="right")
            begins = (ENDS[stretch] - STRETCHES[stretch][2]) if values is joined else 0
            wanted = np.arange(max(begins, last[place] - count + 1), last[place] + 1)
            got = found[place][count - len(wanted) :]
            assert got.tobytes() == np.array(values[wanted]).tobytes()


def test_one_stretch_of_one_array_is_one_copy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Row by row only what reaches before an array's first row."""
    joined, asked = rows_of(STRETCHES), []
    take = JoinedRows.take
    monkeypatch.setattr(
        JoinedRows, "take", lambda self, rows, axis=0: asked.append(rows) or take(self, rows)
    )
    spans = Spans(joined, 2)
    spans.at(np.array([[0, 3, 6], [13, 17, 9]]))
    assert not asked
    spans.at(np.array([0, 7]))  # the first row of the second array, and one before it
    assert [rows.tolist() for rows in asked] == [[[7, 8]]]
