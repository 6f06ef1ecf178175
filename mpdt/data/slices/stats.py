"""Statistics of data columns over training tasks: what a normaliser may know.

Exact, also the quantiles, in bounded memory: columns are read a few at a time from the map,
as many as fit the budget (one column of 5 million rows is 40 MB in float64).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mpdt.data.store.dataset import Dataset
from mpdt.data.store.layout import STATS, STATS_FIELDS
from mpdt.data.store.tables import Float64, Int64, Stats
from mpdt.data.workers.threads import in_order
from mpdt.errors import DataError

_Value = TypeVar("_Value")
_QUANTILES = {name: int(name[1:]) / 100 for name in STATS if name.startswith("q")}


def compute_stats(dataset: Dataset, slice: str = "", budget_bytes: int = 1 << 28) -> Stats:
    """Count, mean, std, min, max and quantiles per column, over tasks of role train or both.

    `observations` counts T+1 rows per episode, the final one included; `returns` has one row
    per episode. `std` is the population's, raw: a normaliser uses max(std, 1e-6). Quantiles
    interpolate linearly between the two nearest rows (numpy's default).

    Args:
        slice: name of a stored slice to look at, "" = the whole file. Test-only tasks in it
            are left out.
        budget_bytes: about the most memory to hold at a time; at least one column is held.
    Raises: UsageError for an unknown slice, DataError where no training episode is left.
    """
    train = dataset.tasks.train_rows
    ids = dataset.select(task=list(train), slice=slice or None)
    if len(ids) == 0:
        raise DataError("no episode of a training task to take statistics of",
                        where=f"{dataset.path}:{slice}" if slice else str(dataset.path),
                        expected="tasks of role train or both")  # fmt: skip
    episodes, steps = dataset.episodes, dataset.steps
    lengths = episodes.length[ids].astype(np.int64)
    observation_rows = _runs(episodes.obs_start[ids], lengths + 1)
    step_rows = _runs(episodes.start[ids], lengths)
    fields = {
        "observations": _table(steps.observations, observation_rows, budget_bytes),
        "actions": _table(steps.actions, step_rows, budget_bytes),
        "rewards": _table(steps.rewards, step_rows, budget_bytes),
        "returns": _table(episodes.returns[ids], [(0, len(ids))], budget_bytes),
    }
    return Stats(
        fields=fields,
        slice=slice,
        tasks_seen=tuple(int(row) for row in np.unique(episodes.task[ids])),
        constant={
            name: tuple(np.flatnonzero(table["min"] == table["max"]).tolist())
            for name, table in fields.items()
        },
    )


def later_stats(dataset: Dataset) -> Stats | None:
    """`compute_stats` of the whole file once somebody looks: its steps are all read for it.

    None where no training task has episodes.
    """
    seen = np.intersect1d(dataset.episodes.task, dataset.tasks.train_rows)
    if not len(seen):
        return None
    found = cache(partial(compute_stats, dataset))
    return Stats(
        fields=_Later(lambda: found().fields),
        slice="",
        tasks_seen=tuple(seen.tolist()),
        constant=_Later(lambda: found().constant),
    )


class _Later(Mapping[str, _Value]):
    """What is known of each field of the steps, made when it is first asked for."""

    def __init__(self, make: Callable[[], Mapping[str, _Value]]) -> None:
        self._make = make

    def __getitem__(self, name: str) -> _Value:
        return self._make()[name]

    def __contains__(self, name: object) -> bool:
        return name in STATS_FIELDS

    def __iter__(self) -> Iterator[str]:
        return iter(STATS_FIELDS)

    def __len__(self) -> int:
        return len(STATS_FIELDS)


def _runs(starts: Int64, lengths: Int64) -> list[tuple[int, int]]:
    """Row ranges of ascending episodes, neighbours merged: few long reads, not many short ones."""
    runs: list[tuple[int, int]] = []
    for start, length in zip(starts.tolist(), lengths.tolist(), strict=True):
        if runs and runs[-1][1] == start:
            runs[-1] = (runs[-1][0], start + length)
        else:
            runs.append((start, start + length))
    return runs


def _table(
    array: NDArray[Any], runs: list[tuple[int, int]], budget_bytes: int
) -> dict[str, Float64]:
    count = sum(stop - start for start, stop in runs)
    width = 1 if array.ndim == 1 else array.shape[1]
    table = {name: np.empty(width) for name in STATS}
    table["count"][:] = count
    for first, block in _column_blocks(array, width, runs, count, budget_bytes):
        columns = np.s_[first : first + len(block)]
        # A row of `block` is one column of the data, contiguous: numpy sums it pairwise, so
        # the result does not depend on how many columns are held at a time.
        table["mean"][columns] = mean = block.mean(axis=1)
        table["min"][columns] = block.min(axis=1)
        table["max"][columns] = block.max(axis=1)
        # Column by column: with an axis numpy would select along the far one of a whole copy.
        quantiles = np.stack(list(in_order(_quantiles, block)), 1)
        for name, values in zip(_QUANTILES, quantiles, strict=True):
            table[name][columns] = values
        block -= mean[:, None]
        np.square(block, out=block)
        table["std"][columns] = np.sqrt(block.mean(axis=1))
    # The mean of equal numbers may be off by a rounding, which would leave a spread.
    constant = table["min"] == table["max"]
    table["mean"][constant], table["std"][constant] = table["min"][constant], 0.0
    return table


def _quantiles(row: Float64) -> Float64:
    return np.asarray(np.quantile(row, list(_QUANTILES.values())))


def _column_blocks(
    array: NDArray[Any], width: int, runs: list[tuple[int, int]], count: int, budget_bytes: int
) -> Iterator[tuple[int, Float64]]:
    """(first column, (columns, rows) float64), the rows of all runs one after another."""
    # Three times: np.quantile partitions a copy, and the caller holds the block meanwhile.
    held = max(1, budget_bytes // (3 * 8 * count))
    for first in range(0, width, held):
        last = min(first + held, width)
        block = np.empty((last - first, count))
        row = 0
        for start, stop in runs:
            key = slice(start, stop), *([slice(first, last)] if array.ndim > 1 else [])
            block[:, row : row + stop - start] = array[key].T
            row += stop - start
        yield first, block
