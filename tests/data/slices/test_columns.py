"""Two passes over leaves give to the bit what numpy says of a whole column, whatever is in it."""

from __future__ import annotations

import numpy as np
import pytest

from mpdt.data.slices.columns import LEAF_ROWS, QUANTILES, _leaves, table_of, whole_column

COUNT = 70_001
RNG = np.random.default_rng(0)
NORMAL = RNG.standard_normal((COUNT, 2)).astype(np.float32)
ZEROS = np.where(RNG.random((COUNT, 2)) < 0.3, np.float32(-0.0), np.round(NORMAL))
KINDS = {
    "normal": NORMAL,
    "large": NORMAL * np.float32(1e30),
    "tiny": NORMAL * np.float32(1e-41),  # without a leading bit
    "few values": np.round(NORMAL, 1),
    "two kinds of zero": ZEROS,
    "constant": np.full((COUNT, 2), np.float32(1.1)),
    "one is infinite": np.where(np.arange(COUNT)[:, None] == 7, np.float32(-np.inf), NORMAL),
    "one is NaN": np.where(np.arange(COUNT)[:, None] == 7, np.float32(np.nan), NORMAL),
}


def same(array: np.ndarray, runs: list[tuple[int, int]], leaf_rows: int) -> None:
    table = table_of(array, runs, leaf_rows)
    rows = np.concatenate([array[start:stop] for start, stop in runs])
    for column in range(rows.shape[1]):
        with np.errstate(invalid="ignore"):
            wanted = whole_column(rows[:, column].astype(np.float64))
        for name, value in wanted.items():
            found = table[name][column]
            assert np.float64(value).tobytes() == found.tobytes() or (
                np.isnan(value) and np.isnan(found)
            ), (name, column, value, found)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [1, 2, 9, 130, 1_000])
def test_few_rows(kind: str, count: int) -> None:
    same(KINDS[kind], [(0, count)], LEAF_ROWS)
    same(KINDS[kind], [(0, count)], 128)


@pytest.mark.parametrize("kind", KINDS)
def test_many_rows_of_several_runs(kind: str) -> None:
    """Three leaves and more; runs end inside of them, one is a single row."""
    same(KINDS[kind], [(0, 40_000), (40_100, 40_101), (41_000, COUNT)], LEAF_ROWS)


def test_so_many_in_one_bin_that_they_are_counted() -> None:
    """More than 65,536 numbers that begin with the same 16 bits, of both signs."""
    near = 1 + NORMAL.reshape(-1, 1) * np.float32(1e-4)
    same(np.concatenate([near, -near, -near]), [(0, 6 * COUNT)], LEAF_ROWS)


def test_leaves_are_the_halves_that_numpy_adds() -> None:
    assert list(_leaves(0, 100, 1)) == [(0, 100)]
    assert list(_leaves(0, 300, 128)) == [(0, 72), (72, 144), (144, 216), (216, 300)]


def test_numbers_of_64_bits_are_asked_of_numpy() -> None:
    rows = np.array([1e100, 2.0, 4.0])
    table = table_of(rows, [(0, 3)])
    assert (table["count"][0], table["q50"][0], table["max"][0]) == (3, 4, 1e100)
    assert set(QUANTILES) < set(table)
