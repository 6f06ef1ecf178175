"""A LeRobot tree as it lies on the disk: its tasks' texts, its columns, its episodes.

    meta/info.json                                   codebase_version, features
    meta/tasks.parquet   meta/tasks.jsonl (v2)       task_index -> text
    data/chunk-*/file-*.parquet                      many episodes a file
    data/chunk-*/episode_*.parquet (v2)              one

Versions v3, v2.1 and v2.0, read with pyarrow alone. Nothing in it is believed. Source:
huggingface/lerobot, src/lerobot/datasets (v2.1, v3.0).
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

from mpdt.data.exchange.folder import files_below
from mpdt.data.exchange.treatment import RawEpisode
from mpdt.errors import DataError, FormatError, MpdtError, UsageError
from mpdt.reading import decode_json, read_json, read_plain, refuse_other

STATES = ("observation.state", "observation.environment_state")
ACTION, REWARD = "action", "next.reward"
_SUCCESS = "next.success"
_EPISODE, TASK = "episode_index", "task_index"
_PICTURES = ("video", "image")
_DAMAGE = (pa.ArrowException, OSError, KeyError, ValueError, TypeError, IndexError, AttributeError)
_MOST_COMPRESSED = 1000
"""Bytes per stored one at most."""
Label = int | float | str
_CACHED_FILES = 4
"""Data files are at most 100 MB by the format, and are looked at once per task in them."""


@dataclass(frozen=True)
class Tree:
    """One dataset.

    Args:
        texts: by task_index.
        widths: columns of numbers or text, by name.
        pictures: names of what has no place here.
        names: what the tree calls the numbers of a column, where it does.
        fps: rows per second; 0 = not said.
    """

    folder: Path
    texts: Mapping[int, str]
    widths: Mapping[str, int]
    pictures: tuple[str, ...]
    names: Mapping[str, tuple[str, ...]]
    fps: float

    @property
    def files(self) -> list[Path]:
        return files_below([self.folder / "data"], ".parquet")

    def text_of(self, number: Label) -> str:
        """Of a task_index. Raises: FormatError for one without text."""
        for known, text in self.texts.items():
            if known == number:
                return text.strip()
        raise FormatError(f"task_index {number} has no text", where=str(self.folder),
                          found=f"{len(self.texts)} tasks")  # fmt: skip


@dataclass(frozen=True)
class Wanted:
    """What is read of the data files.

    Args:
        states: columns that are the observation, side by side.
        success: whether there is one.
        by: the column whose value tells tasks apart, one value per episode.
    """

    states: tuple[str, ...]
    success: bool
    by: str = TASK

    @property
    def columns(self) -> tuple[str, ...]:
        return (*self.states, ACTION, REWARD, *([_SUCCESS] if self.success else []))

    @staticmethod
    def of(tree: Tree, states: Sequence[str], by: str = TASK) -> Wanted:
        return Wanted(tuple(states), _SUCCESS in tree.widths, by)


@dataclass(frozen=True)
class Rows:
    """The columns of a data file; `bounds` are the rows of each episode, `labels` its task's."""

    columns: Mapping[str, NDArray[Any]]
    bounds: tuple[tuple[int, int], ...]
    labels: tuple[Label, ...]

    def of(self, label: Label) -> list[tuple[int, int]]:
        return [rows for rows, known in zip(self.bounds, self.labels, strict=True)
                if known == label]  # fmt: skip

    def only_last_success(self) -> int:
        """Episodes that succeed in their last row and in no other."""
        flags = self.columns.get(_SUCCESS)
        if flags is None:
            return 0
        return sum(bool(flags[b - 1]) and not flags[a : b - 1].any() for a, b in self.bounds)


def trees(paths: Sequence[Path]) -> Iterator[Tree]:
    """Raises: UsageError for none; FormatError for one that is damaged or of another version."""
    found = [path for path in files_below(paths, ".json") if path.name == "info.json"]
    if not found:
        raise UsageError("no LeRobot tree", where=str(paths[0]) if paths else "",
                         expected="a folder with meta/info.json")  # fmt: skip
    for info in found:
        content = read_json(info)
        version = content.get("codebase_version")
        if version not in ("v2.0", "v2.1", "v3.0"):
            raise FormatError("not a LeRobot tree of a known version", where=str(info),
                              expected="codebase_version v2.0, v2.1 or v3.0", found=str(version),
                              hint="lerobot converts older ones")  # fmt: skip
        folder = info.parent.parent
        features: Any = content.get("features")
        with _told(info):
            kinds = {str(name): str(one["dtype"]) for name, one in features.items()}
            widths = {name: int(np.prod(features[name]["shape"], dtype=np.int64))
                      for name, kind in kinds.items() if kind not in _PICTURES}  # fmt: skip
        pictures = tuple(name for name, kind in kinds.items() if kind in _PICTURES)
        names = {name: tuple(said) for name, one in features.items()
                 if isinstance(said := one.get("names"), list)
                 and all(isinstance(word, str) for word in said)}  # fmt: skip
        texts = _texts_v3(folder) if version == "v3.0" else _texts_v2(folder)
        fps = content.get("fps")
        rate = float(fps) if isinstance(fps, int | float) and 0 < fps < 1e6 else 0.0
        yield Tree(folder, texts, widths, pictures, names, rate)


def _texts_v3(folder: Path) -> dict[int, str]:
    path = folder / "meta/tasks.parquet"
    with _told(path):
        table = pq.read_table(path, partitioning=None)
        (text,) = [name for name in table.column_names if name != TASK]
        pairs = zip(table[TASK].to_pylist(), table[text].to_pylist(), strict=True)
        return {int(number): str(said) for number, said in pairs}


def _texts_v2(folder: Path) -> dict[int, str]:
    path = folder / "meta/tasks.jsonl"
    lines = read_plain(path).splitlines()
    with _told(path):
        rows = [decode_json(line) for line in lines if line.strip()]
        return {int(row[TASK]): str(row["task"]) for row in rows}


def by_task(tree: Tree, wanted: Wanted) -> Iterator[tuple[Path, Label]]:
    """Every file of a tree with each of its tasks' labels, ascending."""
    for path in tree.files:
        for label in sorted(set(read_rows(path, wanted).labels)):
            yield path, label


def left_out(tree: Tree, wanted: Wanted) -> list[str]:
    """What a user should know of what is not taken from a tree."""
    rows = [read_rows(path, wanted) for path in tree.files]
    count, late = sum(len(one.bounds) for one in rows), sum(one.only_last_success() for one in rows)
    told = (f"{tree.folder}: left out the last step of each of {count} episodes: the "
            "format has no observation after it")  # fmt: skip
    if late:
        told += f"; with it the only success of {late}"
    states = [name for name in STATES if name in tree.widths and name not in wanted.states]
    names = [*tree.pictures, *(f"{name} of {tree.widths[name]} numbers" for name in states)]
    return [told, *([f"{tree.folder}: left out {', '.join(names)}"] if names else [])]


def episodes(path: Path, wanted: Wanted, label: Label) -> Iterator[RawEpisode]:
    """Those of one task in a file, without their last steps.

    Raises: FormatError; DataError for an episode of one row.
    """
    rows = read_rows(path, wanted)
    states = [_matrix(rows.columns[name]) for name in wanted.states]
    observations = states[0] if len(states) == 1 else np.concatenate(states, axis=1)
    actions, rewards = _matrix(rows.columns[ACTION]), rows.columns[REWARD]
    successes = rows.columns.get(_SUCCESS)
    for first, end in rows.of(label):
        if end - first < 2:
            raise DataError("an episode of one row has no step", where=f"{path}: row {first}",
                            expected="two rows or more: the last of each is left out")  # fmt: skip
        steps = slice(first, end - 1)
        last = np.arange(end - first - 1) == end - first - 2
        yield RawEpisode(
            observations=observations[first:end], actions=actions[steps], rewards=rewards[steps],
            terminations=np.zeros_like(last), truncations=last,
            successes=None if successes is None else successes[steps],
        )  # fmt: skip


def _matrix(column: NDArray[Any]) -> NDArray[Any]:
    """(N, D); vectors of one number are stored as numbers."""
    return column[:, np.newaxis] if column.ndim == 1 else column


def read_rows(path: Path, wanted: Wanted) -> Rows:
    """Raises: FormatError for a file that is damaged, lacks a column, or mixes its episodes."""
    refuse_other(path, "a Parquet file", "a Parquet file")
    found = path.stat()
    return _read_rows(path, wanted, (found.st_ino, found.st_size, found.st_mtime_ns))


@lru_cache(maxsize=_CACHED_FILES)
def _read_rows(path: Path, wanted: Wanted, file: tuple[int, ...]) -> Rows:
    """`file` tells one that took the same place meanwhile."""
    names = (*dict.fromkeys((*wanted.columns, _EPISODE, wanted.by)),)
    with _told(path):
        _check_size(path, names)
        # A text that repeats takes no place in the file, and takes none here.
        table = pq.read_table(path, columns=list(names), partitioning=None,
                              read_dictionary=[wanted.by])  # fmt: skip
        columns = {name: _numbers(table[name]) for name in (*wanted.columns, _EPISODE)}
        numbers = columns[_EPISODE].reshape(-1)
        edges = np.flatnonzero(np.diff(numbers)) + 1
        bounds = [0, *edges.tolist(), len(numbers)] if len(numbers) else [0]
        if len(np.unique(numbers)) != len(bounds) - 1:
            raise ValueError("rows of an episode that do not lie together")
        codes, known = _labels(table[wanted.by])
        for first, end in pairwise(bounds):
            if len(np.unique(codes[first:end])) != 1:
                if wanted.by != TASK:
                    raise UsageError(f"episode {numbers[first]} has several tasks",
                                     where=f"{path}: --task-from", found=wanted.by,
                                     expected="a column that stays the same in it")  # fmt: skip
                raise ValueError(f"episode {numbers[first]} has several tasks")
    labels = tuple(known[code] for code in codes[bounds[:-1]].tolist())
    return Rows(columns, tuple(pairwise(bounds)), labels)


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
def _told(path: Path) -> Iterator[None]:
    """What pyarrow or Python say of a file that makes no sense, as one error."""
    try:
        yield
    except MpdtError:
        raise
    except _DAMAGE as error:
        raise FormatError("not part of a LeRobot tree", where=str(path),
                          found=f"{type(error).__name__}: {error}".splitlines()[0],
                          hint="take another copy of the tree") from error  # fmt: skip
