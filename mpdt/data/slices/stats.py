"""Statistics of data columns over training tasks: what a normaliser may know.

Exact, also the quantiles, in memory that does not grow with the steps: `columns.py` has how.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mpdt.data.slices.columns import table_of
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.layout import STATS_FIELDS
from mpdt.data.store.tables import Float64, Int64, Stats
from mpdt.errors import DataError

_Value = TypeVar("_Value")


def compute_stats(dataset: Dataset, slice: str = "") -> Stats:
    """Count, mean, std, min, max and quantiles per column, over tasks of role train or both.

    `observations` counts T+1 rows per episode, the final one included; `returns` has one row
    per episode. `std` is the population's, raw: a normaliser uses max(std, 1e-6). Quantiles
    interpolate linearly between the two nearest rows (numpy's default).

    Args:
        slice: name of a stored slice to look at, "" = the whole file. Test-only tasks in it
            are left out.
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
        "observations": _table(steps.observations, observation_rows),
        "actions": _table(steps.actions, step_rows),
        "rewards": _table(steps.rewards, step_rows),
        "returns": _table(episodes.returns[ids], [(0, len(ids))]),
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


def _table(array: NDArray[Any], runs: list[tuple[int, int]]) -> dict[str, Float64]:
    table = table_of(array, runs)
    # The mean of equal numbers may be off by a rounding, which would leave a spread.
    constant = table["min"] == table["max"]
    table["mean"][constant], table["std"][constant] = table["min"][constant], 0.0
    return table
