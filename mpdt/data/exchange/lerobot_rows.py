"""The rows of a LeRobot data file: its columns, and where its episodes begin and end.

Rows of an episode lie together and are counted from 0; a file in which one is lost is refused,
because what lies to both sides of it is no step.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from mpdt.errors import FormatError, MpdtError, UsageError
from mpdt.reading import refuse_other

ACTION, REWARD, SUCCESS = "action", "next.reward", "next.success"
_EPISODE, FRAME, TASK = "episode_index", "frame_index", "task_index"
_DAMAGE = (pa.ArrowException, OSError, KeyError, ValueError, TypeError, IndexError, AttributeError)
_MOST_COMPRESSED = 1000
"""Bytes per stored one at most."""
Label = int | float | str
_CACHED_FILES = 4
"""Data files are at most 100 MB by the format, and are looked at once per task in them."""


@dataclass(frozen=True)
class Wanted:
    """What is read of the data files.

    Args:
        states: columns that are the observation, side by side.
        success: whether there is one.
        by: the column whose value tells tasks apart, one value per episode.
        frames: whether rows are numbered within their episode.
    """

    states: tuple[str, ...]
    success: bool
    by: str = TASK
    frames: bool = False

    @property
    def columns(self) -> tuple[str, ...]:
        return (*self.states, ACTION, REWARD, *([SUCCESS] if self.success else []))


@dataclass(frozen=True)
class Rows:
    """The columns of a data file; `bounds` are the rows of each episode, `labels` its task's,
    `numbers` the episodes' own."""

    columns: Mapping[str, NDArray[Any]]
    numbers: tuple[int, ...]
    bounds: tuple[tuple[int, int], ...]
    labels: tuple[Label, ...]

    def of(self, label: Label) -> list[tuple[int, int]]:
        return [rows for rows, known in zip(self.bounds, self.labels, strict=True)
                if known == label]  # fmt: skip

    def only_last_success(self) -> int:
        """Episodes that succeed in their last row and in no other."""
        flags = self.columns.get(SUCCESS)
        if flags is None:
            return 0
        return sum(bool(flags[b - 1]) and not flags[a : b - 1].any() for a, b in self.bounds)


def read_rows(path: Path, wanted: Wanted) -> Rows:
    """Raises: FormatError for a file that is damaged, lacks a column, or mixes its episodes."""
    refuse_other(path, "a Parquet file", "a Parquet file")
    found = path.stat()
    return _read_rows(path, wanted, (found.st_ino, found.st_size, found.st_mtime_ns))


@lru_cache(maxsize=_CACHED_FILES)
def _read_rows(path: Path, wanted: Wanted, file: tuple[int, ...]) -> Rows:
    """`file` tells one that took the same place meanwhile."""
    own = (_EPISODE, *([FRAME] if wanted.frames else []))
    names = (*dict.fromkeys((*wanted.columns, *own, wanted.by)),)
    with telling(path):
        _check_size(path, names)
        # A text that repeats takes no place in the file, and takes none here.
        table = pq.read_table(path, columns=list(names), partitioning=None,
                              read_dictionary=[wanted.by])  # fmt: skip
        columns = {name: _numbers(table[name]) for name in (*wanted.columns, *own)}
        numbers = columns[_EPISODE].reshape(-1)
        edges = np.flatnonzero(np.diff(numbers)) + 1
        bounds = [0, *edges.tolist(), len(numbers)] if len(numbers) else [0]
        if len(np.unique(numbers)) != len(bounds) - 1:
            raise ValueError("rows of an episode that do not lie together")
        if wanted.frames:
            _check_frames(columns[FRAME].reshape(-1), numbers, bounds)
        codes, known = _labels(table[wanted.by])
        for first, end in pairwise(bounds):
            if len(np.unique(codes[first:end])) != 1:
                if wanted.by != TASK:
                    raise UsageError(f"episode {numbers[first]} has several tasks",
                                     where=f"{path}: --task-from", found=wanted.by,
                                     expected="a column that stays the same in it")  # fmt: skip
                raise ValueError(f"episode {numbers[first]} has several tasks")
    labels = tuple(known[code] for code in codes[bounds[:-1]].tolist())
    own_numbers = tuple(numbers[bounds[:-1]].tolist())
    return Rows(columns, own_numbers, tuple(pairwise(bounds)), labels)


def _check_frames(frames: NDArray[Any], episodes: NDArray[Any], bounds: Sequence[int]) -> None:
    """Raises: ValueError unless the rows of every episode are counted from 0: what lies to both
    sides of a lost row is no step."""
    expected = np.arange(len(frames)) - np.repeat(bounds[:-1], np.diff(bounds))
    wrong = np.flatnonzero(frames != expected)
    if len(wrong):
        at = int(wrong[0])
        raise ValueError(f"episode {episodes[at]} has row {frames[at]} in the place of row "
                         f"{expected[at]}: rows are missing or doubled")  # fmt: skip


def _labels(column: Any) -> tuple[NDArray[Any], list[Label]]:
    """A code per row, and what each stands for. Raises: ValueError for empty cells."""
    chunk = column.unify_dictionaries().combine_chunks()
    if isinstance(chunk, pa.ChunkedArray):
        chunk = pa.concat_arrays(chunk.chunks) if chunk.num_chunks else pa.array([], chunk.type)
    if not pa.types.is_dictionary(chunk.type):
        chunk = chunk.dictionary_encode()
    if chunk.null_count:
        raise ValueError("a column has empty cells")
    return chunk.indices.to_numpy(zero_copy_only=False), chunk.dictionary.to_pylist()


def _check_size(path: Path, names: Sequence[str]) -> None:
    """A run of equal numbers takes no place in the format: a file may announce anything."""
    with pq.ParquetFile(path) as file:
        groups = [file.metadata.row_group(i) for i in range(file.num_row_groups)]
    columns = [group.column(i) for group in groups for i in range(group.num_columns)]
    count = sum(one.num_values for one in columns
                if any(one.path_in_schema in (n, f"{n}.list.element", f"{n}.list.item")
                       for n in names))  # fmt: skip
    if 8 * count > _MOST_COMPRESSED * path.stat().st_size + 1_000_000:
        raise ValueError(f"announces {count:,} numbers, more than a file of its size can hold")


def _numbers(column: Any) -> NDArray[Any]:
    """(N,) or (N, D) of numbers or lists of one length. Raises: ValueError."""
    chunk = column.combine_chunks()
    if isinstance(chunk, pa.ChunkedArray):
        chunk = pa.concat_arrays(chunk.chunks) if chunk.num_chunks else pa.array([], chunk.type)
    rows, kind = len(chunk), chunk.type
    is_list = pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind)
    flat = chunk.flatten() if is_list else chunk
    if chunk.null_count or flat.null_count:
        raise ValueError("a column has empty cells")
    values: NDArray[Any] = flat.to_numpy(zero_copy_only=False)
    if is_list and rows:
        lengths = np.diff(chunk.offsets) if pa.types.is_list(kind) else [len(flat) // rows]
        if len(np.unique(lengths)) > 1:
            raise ValueError("vectors of several lengths")
        values = values.reshape(rows, -1)
    return values


@contextmanager
def telling(path: Path) -> Iterator[None]:
    """What pyarrow or Python say of a file that makes no sense, as one error."""
    try:
        yield
    except MpdtError:
        raise
    except _DAMAGE as error:
        raise FormatError("not part of a LeRobot tree", where=str(path),
                          found=f"{type(error).__name__}: {error}".splitlines()[0],
                          hint="take another copy of the tree") from error  # fmt: skip
