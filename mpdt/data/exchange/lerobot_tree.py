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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from mpdt.data.exchange.folder import files_below
from mpdt.data.exchange.lerobot_rows import (
    ACTION,
    FRAME,
    REWARD,
    SUCCESS,
    TASK,
    Label,
    Wanted,
    read_rows,
    telling,
)
from mpdt.data.exchange.treatment import RawEpisode
from mpdt.errors import DataError, FormatError, UsageError
from mpdt.reading import decode_json, read_json, read_plain

STATES = ("observation.state", "observation.environment_state")
_PICTURES = ("video", "image")


@dataclass(frozen=True)
class Tree:
    """One dataset.

    Args:
        texts: by task_index.
        widths: columns of numbers or text, by name.
        pictures: names of what has no place here.
        names: what the tree calls the numbers of a column, where it does.
        fps: rows per second; 0 = not said.
        announced: episodes and rows that info.json counts; None = it does not.
    """

    folder: Path
    texts: Mapping[int, str]
    widths: Mapping[str, int]
    pictures: tuple[str, ...]
    names: Mapping[str, tuple[str, ...]]
    fps: float
    announced: tuple[int | None, int | None]

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


def wanted_of(tree: Tree, states: Sequence[str], by: str = TASK) -> Wanted:
    return Wanted(tuple(states), SUCCESS in tree.widths, by, FRAME in tree.widths)


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
        with telling(info):
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
        counts = [content.get(f"total_{what}") for what in ("episodes", "frames")]
        told = [one if type(one) is int else None for one in counts]
        yield Tree(folder, texts, widths, pictures, names, rate, (told[0], told[1]))


def _texts_v3(folder: Path) -> dict[int, str]:
    path = folder / "meta/tasks.parquet"
    with telling(path):
        table = pq.read_table(path, partitioning=None)
        (text,) = [name for name in table.column_names if name != TASK]
        pairs = zip(table[TASK].to_pylist(), table[text].to_pylist(), strict=True)
        return {int(number): str(said) for number, said in pairs}


def _texts_v2(folder: Path) -> dict[int, str]:
    path = folder / "meta/tasks.jsonl"
    lines = read_plain(path).splitlines()
    with telling(path):
        rows = [decode_json(line) for line in lines if line.strip()]
        return {int(row[TASK]): str(row["task"]) for row in rows}


def by_task(tree: Tree, wanted: Wanted) -> Iterator[tuple[Path, Label]]:
    """Every file of a tree with each of its tasks' labels, ascending.

    Raises: FormatError at the end unless the files hold what info.json counts, copies once.
    """
    lengths: dict[int, int] = {}
    for path in tree.files:
        rows = read_rows(path, wanted)
        lengths |= {number: end - first for number, (first, end)
                    in zip(rows.numbers, rows.bounds, strict=True)}  # fmt: skip
        for label in sorted(set(rows.labels)):
            yield path, label
    found = (len(lengths), sum(lengths.values()))
    for what, asked, there in zip(("episodes", "rows"), tree.announced, found, strict=True):
        if asked is not None and asked != there:
            raise FormatError(f"not the number of {what} in its metadata", where=str(tree.folder),
                              expected=str(asked), found=str(there),
                              hint="take another copy of the tree")  # fmt: skip


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
    successes = rows.columns.get(SUCCESS)
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
