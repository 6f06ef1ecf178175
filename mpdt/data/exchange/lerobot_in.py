"""LeRobot trees in: v3, and v2.0 and v2.1 before it, read with pyarrow alone.

    meta/info.json                                   codebase_version, features
    meta/tasks.parquet   meta/tasks.jsonl (v2)       task_index -> text
    data/chunk-*/file-*.parquet                      many episodes a file
    data/chunk-*/episode_*.parquet (v2)              one

The format has no observation after an episode's last step, so that step is left out, and with it
how the episode ended: each is cut off where its rows end, and the file has no time limit. Videos
and images are left out too. Source: huggingface/lerobot, src/lerobot/datasets (v2.1, v3.0).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from mpdt.data.exchange import foreign
from mpdt.data.exchange.folder import files_below
from mpdt.data.exchange.foreign import Source, quality_code
from mpdt.data.exchange.incoming import Incoming
from mpdt.data.exchange.treatment import RawEpisode, Rules
from mpdt.data.spec.tasks import Family, Task
from mpdt.errors import FormatError, MpdtError, ShapeError, UsageError, nearest, quoted
from mpdt.reading import decode_json, read_json, read_plain, refuse_other

_STATES = ("observation.state", "observation.environment_state")
_ACTION, _REWARD, _SUCCESS = "action", "next.reward", "next.success"
_EPISODE, _TASK = "episode_index", "task_index"
_PICTURES = ("video", "image")
_VERSION = re.compile(r"-v[0-9]+$")  # reach-v2 and reach-v3 are one task
_DAMAGE = (pa.ArrowException, OSError, KeyError, ValueError, TypeError, IndexError, AttributeError)
_MOST_COMPRESSED = 1000
"""Bytes per stored one at most."""
_CACHED_FILES = 4
"""Data files are at most 100 MB by the format, and are looked at once per task in them."""


@dataclass(frozen=True)
class _Tree:
    """One dataset.

    Args:
        texts: by task_index.
        widths: columns of numbers, by name.
        pictures: names of what has no place here.
    """

    folder: Path
    texts: Mapping[int, str]
    widths: Mapping[str, int]
    pictures: tuple[str, ...]

    @property
    def files(self) -> list[Path]:
        return files_below([self.folder / "data"], ".parquet")


@dataclass(frozen=True)
class _Rows:
    """The columns of a data file; `bounds` are the rows of each episode."""

    columns: Mapping[str, NDArray[Any]]
    bounds: tuple[tuple[int, int], ...]

    def of_task(self, task: int) -> list[tuple[int, int]]:
        return [(a, b) for a, b in self.bounds if int(self.columns[_TASK][a]) == task]


def read(paths: Sequence[Path], rules: Rules | None, name: str) -> Incoming:
    """Trees of one family. A task is known by its text: `reach`, `reach-v3` or `ml10: reach`; or
    `--task` names that of all.

    Raises: UsageError, FormatError, DataError, ShapeError naming file and episode.
    """
    rules = replace(foreign.given(rules), any_length=True)
    sources, remarks = [], []
    for tree in _trees(paths):
        state = _state_column(tree, rules.family)
        wanted = (state, _ACTION, _REWARD, *([_SUCCESS] if _SUCCESS in tree.widths else []))
        episodes = 0
        for path in tree.files:
            rows = _rows(path, wanted)
            episodes += len(rows.bounds)
            for task in np.unique([rows.columns[_TASK][a] for a, _ in rows.bounds]).tolist():
                sources.append(_source(path, wanted, task, tree, rules))
        remarks.append(f"{tree.folder}: left out the last step of each of {episodes} episodes: the "
                       "format has no observation after it")  # fmt: skip
        if tree.pictures:
            remarks.append(f"{tree.folder}: left out {', '.join(tree.pictures)}")
    return foreign.incoming(sources, rules, name, remarks)


def _source(path: Path, wanted: Sequence[str], task: int, tree: _Tree, rules: Rules) -> Source:
    return Source(
        path, _task(tree, task, rules), quality_code(rules.quality or "unknown"),
        partial(_episodes, path, tuple(wanted), task),
    )  # fmt: skip


def _trees(paths: Sequence[Path]) -> Iterator[_Tree]:
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
        texts = _texts_v3(folder) if version == "v3.0" else _texts_v2(folder)
        yield _Tree(folder, texts, widths, pictures)


def _texts_v3(folder: Path) -> dict[int, str]:
    path = folder / "meta/tasks.parquet"
    with _told(path):
        table = pq.read_table(path, partitioning=None)
        (text,) = [name for name in table.column_names if name != _TASK]
        pairs = zip(table[_TASK].to_pylist(), table[text].to_pylist(), strict=True)
        return {int(number): str(said) for number, said in pairs}


def _texts_v2(folder: Path) -> dict[int, str]:
    path = folder / "meta/tasks.jsonl"
    lines = read_plain(path).splitlines()
    with _told(path):
        rows = [decode_json(line) for line in lines if line.strip()]
        return {int(row[_TASK]): str(row["task"]) for row in rows}


def _task(tree: _Tree, number: int, rules: Rules) -> Task:
    """Raises: FormatError for a number without text; UsageError for a text that is no task."""
    if rules.task is not None:
        return rules.family.task(rules.task)
    if number not in tree.texts:
        raise FormatError(f"task_index {number} has no text", where=str(tree.folder),
                          found=f"{len(tree.texts)} tasks")  # fmt: skip
    said = tree.texts[number].strip()
    word = _VERSION.sub("", said.removeprefix(f"{rules.family.name}:").strip())
    known = {task.name: task for task in rules.family.tasks}
    if word not in known:
        raise UsageError(f"{rules.family.name} has no task {quoted(said)}", where=str(tree.folder),
                         found=nearest(word, known), hint="name the task of all with --task"
                         )  # fmt: skip
    return known[word]


def _state_column(tree: _Tree, family: Family) -> str:
    """The column that is as wide as the family's observations.

    Raises: ShapeError naming those that are there; for actions or rewards of another width.
    """
    for name, width in ((_ACTION, family.action_size), (_REWARD, 1)):
        if tree.widths.get(name) != width:
            raise ShapeError(f"no {name} of {width} numbers", where=str(tree.folder),
                             expected=f"those of {family.name}",
                             found=str(tree.widths.get(name, "none")))  # fmt: skip
    states = {name: tree.widths[name] for name in _STATES if name in tree.widths}
    fits = [name for name, width in states.items() if width == family.observation_size]
    if not fits:
        raise ShapeError(f"no observation of {family.observation_size} numbers",
                         where=str(tree.folder), expected=f"those of {family.name}",
                         found=", ".join(f"{k} of {v}" for k, v in states.items()) or "none",
                         )  # fmt: skip
    return fits[0]


def _episodes(path: Path, wanted: tuple[str, ...], task: int) -> Iterator[RawEpisode]:
    rows = _rows(path, wanted)
    states, actions, rewards = (rows.columns[name] for name in wanted[:3])
    successes = rows.columns.get(_SUCCESS)
    for first, end in rows.of_task(task):
        steps = slice(first, end - 1)
        last = np.arange(end - first - 1) == end - first - 2
        yield RawEpisode(
            observations=states[first:end], actions=actions[steps], rewards=rewards[steps],
            terminations=np.zeros_like(last), truncations=last,
            successes=None if successes is None else successes[steps],
        )  # fmt: skip


def _rows(path: Path, wanted: tuple[str, ...]) -> _Rows:
    """Raises: FormatError for a file that is damaged, lacks a column, or mixes its episodes."""
    refuse_other(path, "a Parquet file", "a Parquet file")
    found = path.stat()
    return _read_rows(path, wanted, (found.st_ino, found.st_size, found.st_mtime_ns))


@lru_cache(maxsize=_CACHED_FILES)
def _read_rows(path: Path, wanted: tuple[str, ...], file: tuple[int, ...]) -> _Rows:
    """`file` tells one that took the same place meanwhile."""
    names = (*wanted, _EPISODE, _TASK)
    with _told(path):
        _check_size(path, names)
        table = pq.read_table(path, columns=list(names), partitioning=None)
        columns = {name: _numbers(table[name]) for name in table.column_names}
        numbers = columns[_EPISODE].reshape(-1)
        edges = np.flatnonzero(np.diff(numbers)) + 1
        bounds = [0, *edges.tolist(), len(numbers)] if len(numbers) else [0]
        if len(np.unique(numbers)) != len(bounds) - 1:
            raise ValueError("rows of an episode that do not lie together")
        for first, end in pairwise(bounds):
            if len(np.unique(columns[_TASK][first:end])) != 1:
                raise ValueError(f"episode {numbers[first]} has several tasks")
    return _Rows(columns, tuple(pairwise(bounds)))


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
