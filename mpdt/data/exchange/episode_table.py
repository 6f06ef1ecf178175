"""The episode table of a lossless export: the columns of the file format, in rows of its own.

file     task 0 0 1 1 2 2      slice of episodes 2 3 5
export   task 0 0 1            its task table has rows 1 and 2 of the file
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.episode import Episode
from mpdt.data.exchange.manifest import Manifest
from mpdt.data.exchange.selection import Selection
from mpdt.data.store.layout import EPISODES, GOALS, Column
from mpdt.errors import FormatError

Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class EpisodeTable:
    """Columns by name, as `layout.EPISODES` and `layout.GOALS` define them."""

    columns: Columns
    goals: Columns

    @classmethod
    def of(cls, selection: Selection) -> EpisodeTable:
        """Rows of tasks and policies are those of `selection.header`."""
        data, ids = selection.dataset, selection.ids
        episodes, lengths = data.episodes, data.episodes.length[ids].astype(np.int64)
        indices = [task.index for task in selection.header.tasks]
        tasks = np.flatnonzero(np.isin(data.tasks.indices, indices))
        policies = np.flatnonzero(np.isin(data.policies.tasks, tasks))
        goals, goal = np.unique(episodes.goal[ids], return_inverse=True)
        start = np.cumsum(lengths) - lengths
        columns: dict[str, Any] = {
            "task": np.searchsorted(tasks, episodes.task[ids]),
            "policy": np.searchsorted(policies, episodes.policy[ids]),
            "goal": goal,
            "start": start,
            "obs_start": start + np.arange(len(ids)),
            "return": episodes.returns[ids],
        }
        for name in ("length", "quality", "progress", "seed_key", "success", "digest"):
            columns[name] = getattr(episodes, name)[ids]
        if selection.source_ids is not None:
            columns["source"] = selection.source_ids
        table = data.goals
        goal_columns: dict[str, Any] = {
            "values": table.values[goals],
            "dim": table.dims[goals],
            "task": np.searchsorted(tasks, table.tasks[goals]),
        }
        return cls(_in_dtype(columns, EPISODES), _in_dtype(goal_columns, GOALS))

    def check(self, manifest: Manifest, where: str) -> None:
        """Raises: FormatError for a column that is missing, of another type or out of range."""
        rows = {"E": manifest.num_episodes, "M": len(self.goals.get("task", ()))}
        for group, wanted in ((self.columns, EPISODES), (self.goals, GOALS)):
            for column in wanted:
                if column.path in group:
                    _check_column(group[column.path], column, rows, where)
                elif not column.optional:
                    raise FormatError(f"column {column.path} is missing", where=where)
        header, columns = manifest.header, self.columns
        limits = {"task": len(header.tasks), "policy": len(header.policies), "goal": rows["M"]}
        for name, limit in limits.items():
            if len(columns[name]) and not 0 <= columns[name].min() <= columns[name].max() < limit:
                raise FormatError(f"column {name} points outside its table", where=where)
        if (columns["length"] < 1).any() or columns["length"].sum() != manifest.num_steps:
            raise FormatError("lengths do not fit", where=where,
                              expected=f"{manifest.num_steps} steps",
                              found=str(columns["length"].sum()))  # fmt: skip

    def source_ids(self) -> list[int] | None:
        source = self.columns.get("source")
        return None if source is None else [int(i) for i in source]

    def episode(self, i: int, manifest: Manifest, steps: Mapping[str, Any]) -> Episode:
        """Episode `i` of the export from its step arrays, named as in `layout.STEPS`.

        Raises: ShapeError, DataError.
        """
        columns, header, goal = self.columns, manifest.header, int(self.columns["goal"][i])
        key = columns["seed_key"][i]
        return Episode(
            observations=steps["observations"], actions=steps["actions"],
            rewards=steps["rewards"], terminations=steps["terminations"],
            truncations=steps["truncations"], successes=steps.get("successes"),
            task=header.tasks[int(columns["task"][i])].index,
            goal=np.array(self.goals["values"][goal, : self.goals["dim"][goal]]),
            quality=int(columns["quality"][i]), progress=float(columns["progress"][i]),
            policy=header.policies[int(columns["policy"][i])].hash,
            seed_key=(int(key[0]), int(key[1]), int(key[2]), int(key[3]), int(key[4])),
        )  # fmt: skip


def _in_dtype(values: Mapping[str, Any], columns: tuple[Column, ...]) -> Columns:
    return {
        column.path: np.ascontiguousarray(values[column.path], dtype=column.dtype)
        for column in columns
        if column.path in values
    }


def _check_column(array: NDArray[Any], column: Column, rows: Mapping[str, int], where: str) -> None:
    wanted = [rows.get(size, -1) if isinstance(size, str) else size for size in column.shape]
    fits = len(array.shape) == len(wanted) and all(
        want in (-1, have) for want, have in zip(wanted, array.shape, strict=True)
    )
    if not fits or array.dtype != np.dtype(column.dtype):
        raise FormatError(f"column {column.path} is wrong", where=where,
                          expected=f"{column.dtype} of shape {wanted}",
                          found=f"{array.dtype} of shape {list(array.shape)}")  # fmt: skip
