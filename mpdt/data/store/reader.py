"""Open a file: check it, copy the small tables, map the step arrays and large tables, close it.

No HDF5 object outlives `open_dataset`, so the result survives fork, and a writer may replace
the path meanwhile.
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import numpy as np
from numpy.typing import NDArray

from mpdt.data.spec.family import stored_family
from mpdt.data.spec.tasks import FAMILIES
from mpdt.data.store import layout, tables
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.definition import read_definition
from mpdt.data.store.digest import content_hash as hash_content
from mpdt.data.store.integrity import check_names, check_tables
from mpdt.data.store.opening import Opened, Source, opened
from mpdt.data.store.origin import damaged_hint
from mpdt.data.store.references import references_of
from mpdt.data.store.seal import ATTRIBUTE, check_seal
from mpdt.data.store.shown import Slices
from mpdt.data.store.tree import Array, Tree
from mpdt.errors import (
    FormatError,
    StorageError,
    UsageError,
    unknown_name,
)

__all__ = ["Dataset", "open_dataset", "open_tta_rewards", "parse_ref"]


def parse_ref(ref: str) -> tuple[Path, str | None]:
    """Split `FILE:slice` into path and slice name; a plain path has no slice.

    Raises: UsageError for an empty path or slice name.
    """
    path, colon, name = ref.rpartition(":")
    # A colon inside a folder name, a drive letter or an existing file is part of the path.
    if not colon or "/" in name or "\\" in name or os.access(ref, os.F_OK):
        path, name = ref, ""
        colon = ""
    if not path or (colon and not name):
        raise UsageError(f"cannot read '{ref}'", expected="FILE or FILE:slice")
    return Path(path), name or None


def open_dataset(path: Path | str, preload: bool = False) -> Dataset:
    """Open a finished mpdt file for reading.

    Args:
        preload: copy the step arrays to RAM (cold or network disks) instead of mapping them.
    Raises: MissingFileError; FormatError for anything that is not a complete mpdt/1 file;
        StorageError where the system refuses to open it.
    """
    return read_file(Path(path), preload=preload)


def open_again(path: Path, content_hash: str, seal: str, preload: bool) -> Dataset:
    """A dataset that came from another process.

    Raises: as `open_dataset`; StorageError if another file has the path by now.
    """
    dataset = open_dataset(path, preload)
    if (dataset.content_hash, dataset.seal) != (content_hash, seal):
        raise StorageError("another file took its place since it was opened", where=str(path),
                           expected=f"content {content_hash[:8]}, seal {seal[:8]}",
                           found=f"{dataset.content_hash[:8]}, {dataset.seal[:8]}",
                           hint="open the one that is there")  # fmt: skip
    return dataset


def open_tta_rewards(
    data: Dataset | Path | str, name: str, checked: bool = True
) -> tuple[tables.Float32, tables.Bool | None]:
    """What the simulator said about a TTA set: rewards (N,), successes (N,) or None.

    The published zero-shot protocol does not read them; `verify` and protocols that say so do.

    Args:
        data: an open file, which is read on even if another one has its path by now, or a path.
        checked: False for `verify`, as in `read_file`.
    Raises: as `open_dataset`; UsageError for an unknown set.
    """
    if isinstance(data, Dataset) and data.parts:
        return _joined_rewards(data, name, checked)
    source = data.source if isinstance(data, Dataset) else None
    path = data.path if isinstance(data, Dataset) else Path(data)
    with opened(path, source=source) as file:
        tree, group, sizes = file.tree, f"tta/{name}", dict[str, int]()
        if name not in (sets := tree.names("tta")):
            raise unknown_name("TTA set", name, sets, where=str(path))
        if checked:
            check_seal(tree, path)
        tree.columns(f"{group}/steps", layout.TTA_STEPS, sizes)
        found = tree.columns(group, layout.TTA_SIMULATOR, sizes)
        successes = found["sim_successes"].values if "sim_successes" in found else None
        return found["sim_rewards"].values, successes


def _joined_rewards(
    data: Dataset, name: str, checked: bool
) -> tuple[tables.Float32, tables.Bool | None]:
    if name not in data.tta:
        raise unknown_name("TTA set", name, data.tta, where=str(data.path))
    rewards: list[tables.Float32] = []
    successes: list[tables.Bool] = []
    for part, ids in data.tta_in_files(name):
        table, (paid, reached) = part.tta[name], open_tta_rewards(part, name, checked)
        for start, length in zip(table.start[ids], table.length[ids], strict=True):
            rows = slice(int(start), int(start) + int(length))
            rewards.append(paid[rows])
            successes += [] if reached is None else [reached[rows]]
    empty = np.empty(0, np.float32)
    return np.concatenate([empty, *rewards]), np.concatenate(successes) if successes else None


def read_file(
    path: Path, preload: bool = False, unfinished: bool = False, checked: bool = True
) -> Dataset:
    """`open_dataset`, and more for two callers.

    Args:
        unfinished: for the writer, also a file that is not `complete` yet.
        checked: False for `verify`, which looks at rows, ids and hashes itself: names, types
            and numbers of axes are as the format says, and nothing else is known.
    """
    with opened(path, unfinished, in_memory=preload) as file:
        dataset = _read(file, path, _Arrays(file.stream, preload), checked)
        if checked and not unfinished:  # last: what is wrong can be said more clearly before
            check_seal(file.tree, path)
    return dataset


class _Arrays:
    """Maps or copies arrays of one open file."""

    def __init__(self, stream: BinaryIO, preload: bool) -> None:
        self._stream, self._preload, self._warned = stream, preload, False

    def take(self, array: Array) -> NDArray[Any]:
        """A read-only map, or a copy in RAM where that was asked for or nothing can be mapped."""
        offset = array.offset
        if 0 in array.shape or self._preload or offset is None:
            return np.asarray(array.values)
        if offset % array.dtype.itemsize == 0:
            return np.memmap(self._stream, array.dtype, "r", offset, array.shape)
        if not self._warned:
            warnings.warn(
                f"{self._stream.name}: /{array.path} is misaligned; "
                "reading into memory (a file written by mpdt-data is mapped instead)",
                stacklevel=5,
            )
            self._warned = True
        return np.asarray(array.values)


def _columns(
    present: dict[str, Array],
    columns: tuple[layout.Column, ...],
    arrays: _Arrays | None = None,
) -> dict[str, Any]:
    """Values of the columns that `Tree.columns` found; None for the others."""
    values: dict[str, Any] = dict.fromkeys(column.path for column in columns)
    for column in columns:
        array = present.get(column.path)
        if array is None:
            continue
        if column.dtype == "str":
            values[column.path] = array.texts()
        else:
            values[column.path] = arrays.take(array) if arrays else array.values
    return values


def _read(file: Opened, path: Path, arrays: _Arrays, checked: bool = True) -> Dataset:
    tree, where, sizes = file.tree, str(path), dict[str, int]()
    found: dict[str, dict[str, Array]] = {}
    for name, columns in layout.GROUPS.items():
        if name not in tree.groups:
            raise FormatError(f"group /{name} is missing", where=where, hint=damaged_hint(path))
        found[name] = tree.columns(name, columns, sizes if checked else None)
    family, definition = tree.text("", "family"), read_definition(tree)
    episodes = _columns(found["episodes"], layout.EPISODES)
    episodes["returns"] = episodes.pop("return")
    goals = _columns(found["goals"], layout.GOALS)
    policies = _columns(found["policies"], layout.POLICIES)
    slices = {name: _slice_ids(array, where) for name, array in tree.below("slices").items()}
    rules = {name: tree.json(f"slices/{name}", "rule") for name in slices}
    dataset = Dataset(
        path=path, source=Source(path.absolute(), file.stream), family=family,
        name=tree.text("", "name"),
        version=tree.text("", "version"),
        license=tree.text("", "license"),
        spec=tree.json("", "spec"),
        spec_hash=tree.text("", "spec_hash"),
        content_hash=tree.text("", "content_hash"),
        parent=tree.text("", "parent"),
        lineage=_read_lineage(tree), definition=definition,
        # The writer reads its file back before it is sealed; `check_seal` insists on one.
        seal=tree.text("", ATTRIBUTE) if ATTRIBUTE in tree.attributes("") else "",
        packages=tree.json("", "packages"),
        platform=tree.json("", "platform"),
        tasks=_read_tasks(found["tasks"], family, definition, where),
        goals=tables.Goals(goals["values"], goals["dim"], goals["task"]),
        policies=tables.Policies(
            policies["hash"], policies["task"], policies["rung"], policies["level"],
            policies["train_step"], policies["mix_rate"], policies["name"],
        ),
        episodes=tables.Episodes(**episodes),
        steps=tables.Steps(**_columns(found["steps"], layout.STEPS, arrays)),
        slices=Slices(slices, rules),
        slice_rules=rules,
        stats_info=_read_stats(tree) if "stats" in tree.groups else None,
        tta={
            name: _read_tta(name, tree, sizes if checked else None, arrays)
            for name in tree.names("tta")
        },
    )  # fmt: skip
    check_names(dataset)
    if not checked:
        return dataset
    check_tables(dataset)
    content = hash_content(dataset.content_header(), dataset.episodes.digest)
    if content != dataset.content_hash:
        raise FormatError("content hash does not fit the episode digests", where=where,
                          expected=dataset.content_hash, found=content,
                          hint=damaged_hint(path))  # fmt: skip
    return dataset


def _slice_ids(array: Array, where: str) -> tables.Int64:
    if array.dtype.kind not in "iu" or len(array.shape) != 1:
        raise FormatError(f"/{array.path} is no list of ids", where=where,
                          found=f"{array.dtype} of shape {array.shape}")  # fmt: skip
    return np.asarray(array.values, np.int64)


def _read_lineage(tree: Tree) -> tuple[dict[str, Any], ...]:
    """The steps since the file was collected; none in a file that says nothing about them."""
    if "lineage" not in tree.attributes("") and "lineage" not in tree.arrays:
        return ()
    steps: Any = tree.json("", "lineage").get("steps")
    _typed(steps, list[_Step], tree, "its lineage")
    return tuple(steps)


class _Step(msgspec.Struct, frozen=True):
    """What every step of a lineage has; other keys may stand beside."""

    verb: str
    sources: list[str] = msgspec.field(name="from")
    rule: dict[str, Any] | None = None


def _typed(value: Any, kind: Any, tree: Tree, what: str) -> Any:
    """Raises: FormatError for a value of another type than the format writes."""
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise FormatError(f"{what} is not as the format has it", where=tree.where,
                          found=str(error), hint=layout.FOREIGN_HINT) from error  # fmt: skip


def _read_tasks(
    present: dict[str, Array], family: str, definition: dict[str, Any], where: str
) -> tables.Tasks:
    values = _columns(present, layout.TASKS)
    names: tuple[str, ...] = values["name"]
    row_of = stored_family(definition) if definition else FAMILIES.get(family)
    known = {task.name: task.index for task in row_of.tasks} if row_of else {}
    return tables.Tasks(
        names=names,
        indices=tuple(known.get(name, row) for row, name in enumerate(names)),
        envs=tuple(layout.parse_json(text, "/tasks/env") for text in values["env"]),
        roles=values["role"],
        references=tuple(references_of(values, row, where) for row in range(len(names))),
    )


def _read_stats(tree: Tree) -> tables.Stats:
    fields = {}
    for name in layout.STATS_FIELDS:
        columns = tuple(layout.Column(stat, "<f8", (name,)) for stat in layout.STATS)
        if f"stats/{name}" not in tree.groups:
            raise FormatError(f"group /stats/{name} is missing", where=tree.where)
        fields[name] = _columns(tree.columns(f"stats/{name}", columns, {}), columns)
    return tables.Stats(
        fields=fields,
        slice=tree.text("stats", "slice"),
        tasks_seen=tuple(tree.integers("stats", "tasks_seen")),
        constant={
            name: tuple(columns)
            for name, columns in _typed(
                tree.json("stats", "constant"), dict[str, list[int]], tree, "/stats constant"
            ).items()
        },
    )


def _read_tta(
    name: str, tree: Tree, sizes: dict[str, int] | None, arrays: _Arrays
) -> tables.TtaSet:
    own = None if sizes is None else {letter: sizes[letter] for letter in "DA"}
    found = {
        key: tree.columns(f"tta/{name}/{key}".rstrip("/"), columns, own)
        for key, columns in layout.TTA_GROUPS.items()
    }
    return tables.TtaSet(
        name=name,
        rule=tree.json(f"tta/{name}", "rule"),
        content_hash=tree.text(f"tta/{name}", "content_hash"),
        **_columns(found["steps"], layout.TTA_STEPS, arrays),
        **_columns(found["episodes"], layout.TTA_EPISODES),
    )
