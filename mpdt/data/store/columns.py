"""Growing columns of a file under construction: steps go to disk, tables stay small in RAM."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mpdt.data.episode import Episode
from mpdt.data.store import layout
from mpdt.data.store.layout import Column
from mpdt.data.store.tables import Goals, TaskRow
from mpdt.disk import disk
from mpdt.errors import DataError, ShapeError
from mpdt.seeding import UNKNOWN_SEED_KEY

WRITE_BYTES = 4 << 20
"""Of steps that are held back to be written at once."""


def create(group: h5py.Group, column: Column, sizes: dict[str, int]) -> h5py.Dataset:
    """A contiguous dataset whose place in the file is fixed now and never filled twice."""
    shape = tuple(sizes[n] if isinstance(n, str) else n for n in column.shape)
    plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plan.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    plan.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    return group.create_dataset(column.path, shape, np.dtype(column.dtype), dcpl=plan)


def write_table(group: h5py.Group, columns: Sequence[Column], values: dict[str, Any]) -> None:
    """Write small columns; one whose value is None is left out."""
    for column in columns:
        value = values[column.path]
        if value is None:
            continue
        if column.dtype == "str":
            group.create_dataset(column.path, data=list(value), dtype=h5py.string_dtype())
        else:
            group.create_dataset(column.path, data=np.asarray(value, np.dtype(column.dtype)))


class TaskIndex:
    """From a task's family index, which episodes carry, to its row and name in the file."""

    def __init__(self, tasks: Sequence[TaskRow], where: str) -> None:
        self._rows = {task.index: row for row, task in enumerate(tasks)}
        self._tasks, self._where = tasks, where
        indices = [task.index for task in tasks]
        if indices != sorted(set(indices)):
            raise DataError("tasks must ascend by family index", where=where, found=str(indices))

    def row(self, index: int) -> int:
        """Raises: DataError for a task the file does not have."""
        if index not in self._rows:
            raise DataError("episode of a task the file does not have", where=self._where,
                            expected=f"one of {sorted(self._rows)}",
                            found=str(index))  # fmt: skip
        return self._rows[index]

    def name(self, index: int) -> str:
        return self._tasks[self.row(index)].name


class GoalTable:
    """Unique goals in order of first appearance: one row per (task, numbers)."""

    def __init__(self) -> None:
        self._rows: dict[tuple[int, bytes], int] = {}

    def row(self, task_row: int, goal: Any) -> int:
        """Row of a goal, adding it if it is new."""
        key = (task_row, np.asarray(goal, "<f8").tobytes())
        return self._rows.setdefault(key, len(self._rows))

    @classmethod
    def of(cls, goals: Goals) -> GoalTable:
        """The table of an existing file, to be appended to."""
        table = cls()
        for row, task in enumerate(goals.tasks):
            table.row(int(task), goals.of(row))
        return table

    def values(self) -> dict[str, Any]:
        """The columns of `/goals`."""
        goals = [np.frombuffer(numbers, "<f8") for _, numbers in self._rows]
        width = max([len(goal) for goal in goals], default=1) or 1
        padded = np.zeros((len(goals), width))
        for row, goal in enumerate(goals):
            padded[row, : len(goal)] = goal
        dims = [len(goal) for goal in goals]
        return {"values": padded, "dim": dims, "task": [task for task, _ in self._rows]}


class StepTable:
    """Preallocated step arrays of one group, filled episode by episode in canonical order."""

    def __init__(
        self,
        group: h5py.Group,
        arrays: Sequence[tuple[str, h5py.Dataset]],
        num_episodes: int,
        num_steps: int,
        target: Path,
    ) -> None:
        self.target, self._arrays, self._where = target, arrays, str(target)
        self._rows = [rows.shape[1:] for _, rows in arrays]  # h5py asks the file each time
        self._planned = (num_episodes, num_steps)
        self._waiting: list[list[Any]] = [[] for _ in arrays]
        self._first, self._waiting_bytes = (0, 0), 0
        self._last: tuple[int, ...] = ()
        self.num_steps = 0
        # Packed numbers: a list of a million episodes' holds half a gigabyte.
        self.table = {name: array("q") for name in ("task", "goal", "start", "obs_start", "length")}
        self._seed_keys = array("I")

    @property
    def num_episodes(self) -> int:
        return len(self.table["task"])

    def append(self, episode: Episode, task_row: int, goal_row: int) -> None:
        """Take one episode's steps and remember its place; some megabytes are written at once.

        Raises: DataError out of order or beyond the plan, ShapeError for another size or for
            successes present or absent against the plan.
        """
        start, length = self.num_steps, episode.length
        self._check(episode, task_row)
        for (name, _), shape, waiting in zip(self._arrays, self._rows, self._waiting, strict=True):
            value = getattr(episode, name.removeprefix("sim_"))
            if value.shape[1:] != shape:
                raise ShapeError(f"wrong {name}", where=self._where,
                                 expected=f"rows of {shape}",
                                 found=str(value.shape[1:]))  # fmt: skip
            waiting.append(value)
            self._waiting_bytes += value.nbytes
        self._seed_keys.extend(episode.seed_key)
        row = (task_row, goal_row, start, start + self.num_episodes, length)
        for column, number in zip(self.table.values(), row, strict=True):
            column.append(number)
        self.num_steps += length
        if self._waiting_bytes >= WRITE_BYTES:
            self._write()

    def _write(self) -> None:
        """What waits, one call per array: h5py needs as long for an episode as for a hundred."""
        for (name, place), waiting in zip(self._arrays, self._waiting, strict=True):
            if waiting:
                first = sum(self._first) if name == "observations" else self._first[0]
                rows = np.concatenate(waiting)
                place[first : first + len(rows)] = rows
                waiting.clear()
        self._first, self._waiting_bytes = (self.num_steps, self.num_episodes), 0

    def _check(self, episode: Episode, task_row: int) -> None:
        key = (task_row, episode.quality, *episode.seed_key[3:])
        strict = tuple(episode.seed_key) != UNKNOWN_SEED_KEY
        if key < self._last or (strict and key == self._last):
            raise DataError("episodes out of canonical order", where=self._where,
                            expected="ascending (task, quality, block, row)",
                            found=f"{key} after {self._last}")  # fmt: skip
        self._last = key
        wanted = any(name in ("successes", "sim_successes") for name, _ in self._arrays)
        if (episode.successes is not None) != wanted:
            sides = ("present", "None") if wanted else ("None", "present")
            raise ShapeError("successes do not fit the header", where=self._where,
                             expected=sides[0], found=sides[1])  # fmt: skip
        done = (self.num_episodes + 1, self.num_steps + episode.length)
        if done[0] > self._planned[0] or done[1] > self._planned[1]:
            self._disagree("at least {} episodes of {} steps", done)

    def finish(self) -> dict[str, Any]:
        """The columns gathered so far.

        Raises: DataError if fewer episodes or steps came than were planned.
        """
        with disk(self.target):
            self._write()
        if (self.num_episodes, self.num_steps) != self._planned:
            self._disagree("{} episodes of {} steps", (self.num_episodes, self.num_steps))
        return self.table | {"seed_key": np.array(self._seed_keys, "<u4").reshape(-1, 5)}

    def _disagree(self, text: str, counts: tuple[int, int]) -> None:
        raise DataError("not the announced number of episodes", where=self._where,
                        expected="{} episodes of {} steps".format(*self._planned),
                        found=text.format(*counts))  # fmt: skip


def open_steps(
    group: h5py.Group,
    columns: dict[str, Sequence[Column]],
    sizes: dict[str, int],
    target: Path,
) -> StepTable:
    """Create the step arrays of `columns` (subgroup -> its columns) and the table over them.

    `sizes` needs N, E, D and A; R = N + E is derived.
    """
    sizes = sizes | {"R": sizes["N"] + sizes["E"]}
    arrays = [
        (column.path, create(group.require_group(key) if key else group, column, sizes))
        for key, wanted in columns.items()
        for column in wanted
    ]
    return StepTable(group, arrays, sizes["E"], sizes["N"], target)


def step_columns(tta: bool, has_success: bool) -> dict[str, Sequence[Column]]:
    """Subgroup -> step columns of the main table or of a TTA set."""

    def present(columns: Sequence[Column]) -> list[Column]:
        return [column for column in columns if has_success or not column.optional]

    if tta:
        return {"steps": layout.TTA_STEPS, "": present(layout.TTA_SIMULATOR)}
    return {"": present(layout.STEPS)}
