"""Open a file: check it, copy the small tables, map the step arrays, close it.

No HDF5 object outlives `open_dataset`, so the result survives fork, and a writer may replace
the path meanwhile.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np
from numpy.typing import NDArray

from mpdt.data.spec.tasks import FAMILIES
from mpdt.data.store import layout, tables
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.digest import content_hash as hash_content
from mpdt.data.store.integrity import check_tables
from mpdt.data.store.opening import opened
from mpdt.data.store.origin import damaged_hint
from mpdt.data.store.references import references_of
from mpdt.errors import (
    FormatError,
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
    if not colon or "/" in name or "\\" in name or Path(ref).exists():
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


def open_tta_rewards(path: Path | str, name: str) -> tuple[tables.Float32, tables.Bool | None]:
    """What the simulator said about a TTA set: rewards (N,), successes (N,) or None.

    The published zero-shot protocol does not read them; `verify` and protocols that say so do.

    Raises: as `open_dataset`; UsageError for an unknown set.
    """
    path = Path(path)
    with opened(path) as (file, stream):
        sets = file.get("tta", {})
        if name not in sets:
            raise unknown_name("TTA set", name, sets, where=str(path))
        arrays = _Arrays(stream, preload=True)
        group, sizes = sets[name], dict[str, int]()
        layout.check_group(group["steps"], layout.TTA_STEPS, sizes, str(path))
        layout.check_group(group, layout.TTA_SIMULATOR, sizes, str(path))
        successes = arrays.take(group["sim_successes"]) if "sim_successes" in group else None
        return arrays.take(group["sim_rewards"]), successes


def read_file(
    path: Path, preload: bool = False, unfinished: bool = False, checked: bool = True
) -> Dataset:
    """`open_dataset`, and more for two callers.

    Args:
        unfinished: for the writer, also a file that is not `complete` yet.
        checked: False for `verify`, which looks at rows, ids and hashes itself: names, types
            and numbers of axes are as the format says, and nothing else is known.
    """
    with opened(path, unfinished) as (file, stream):
        return _read(file, path, _Arrays(stream, preload), checked)


class _Arrays:
    """Maps or copies datasets of one open file."""

    def __init__(self, stream: BinaryIO, preload: bool) -> None:
        self._stream, self._preload, self._warned = stream, preload, False

    def take(self, dataset: h5py.Dataset) -> NDArray[Any]:
        """A read-only map where the layout allows it, else a copy in RAM."""
        offset = dataset.id.get_offset()
        if 0 in dataset.shape or self._preload:
            return np.asarray(dataset[()])
        mappable = offset is not None and dataset.chunks is None and not dataset.is_virtual
        mappable = mappable and not dataset.external and dataset.dtype.isnative
        if mappable and offset % dataset.dtype.itemsize == 0:
            return np.memmap(self._stream, dataset.dtype, "r", offset, dataset.shape)
        if not self._warned:
            warnings.warn(
                f"{dataset.file.filename}: {dataset.name} is chunked, filtered or misaligned; "
                "reading into memory (a file written by mpdt-data is mapped instead)",
                stacklevel=5,
            )
            self._warned = True
        return np.asarray(dataset[()])


def _columns(
    present: dict[str, h5py.Dataset],
    columns: tuple[layout.Column, ...],
    arrays: _Arrays | None = None,
) -> dict[str, Any]:
    """Values of the columns that `check_group` found; None for the others."""
    values: dict[str, Any] = dict.fromkeys(column.path for column in columns)
    for column in columns:
        dataset = present.get(column.path)
        if dataset is None:
            continue
        if column.dtype == "str":
            values[column.path] = tuple(dataset.asstr()[()])
        else:
            values[column.path] = arrays.take(dataset) if arrays else np.asarray(dataset[()])
    return values


def _read(file: h5py.File, path: Path, arrays: _Arrays, checked: bool = True) -> Dataset:
    where, sizes = str(path), dict[str, int]()
    found: dict[str, dict[str, h5py.Dataset]] = {}
    for name, columns in layout.GROUPS.items():
        if name not in file:
            raise FormatError(f"group /{name} is missing", where=where, hint=damaged_hint(path))
        found[name] = layout.check_group(file[name], columns, sizes if checked else None, where)
    family = layout.read_text(file, "family", where)
    episodes = _columns(found["episodes"], layout.EPISODES)
    episodes["returns"] = episodes.pop("return")
    goals = _columns(found["goals"], layout.GOALS)
    policies = _columns(found["policies"], layout.POLICIES)
    slices = {name: np.asarray(ids[()], np.int64) for name, ids in file.get("slices", {}).items()}
    dataset = Dataset(
        path=path, family=family,
        name=layout.read_text(file, "name", where),
        version=layout.read_text(file, "version", where),
        license=layout.read_text(file, "license", where),
        spec=layout.read_json(file, "spec", where),
        spec_hash=layout.read_text(file, "spec_hash", where),
        content_hash=layout.read_text(file, "content_hash", where),
        parent=layout.read_text(file, "parent", where),
        lineage=_read_lineage(file, where),
        packages=layout.read_json(file, "packages", where),
        platform=layout.read_json(file, "platform", where),
        tasks=_read_tasks(found["tasks"], family),
        goals=tables.Goals(goals["values"], goals["dim"], goals["task"]),
        policies=tables.Policies(
            policies["hash"], policies["task"], policies["rung"], policies["level"],
            policies["train_step"], policies["mix_rate"], policies["name"],
        ),
        episodes=tables.Episodes(**episodes),
        steps=tables.Steps(**_columns(found["steps"], layout.STEPS, arrays)),
        slices=slices,
        slice_rules={n: layout.read_json(file["slices"][n], "rule", where) for n in slices},
        stats_info=_read_stats(file["stats"], where) if "stats" in file else None,
        tta={
            n: _read_tta(n, g, sizes if checked else None, where, arrays)
            for n, g in file.get("tta", {}).items()
        },
    )  # fmt: skip
    if not checked:
        return dataset
    check_tables(dataset)
    content = hash_content(dataset.content_header(), dataset.episodes.digest)
    if content != dataset.content_hash:
        raise FormatError("content hash does not fit the episode digests", where=where,
                          expected=dataset.content_hash, found=content,
                          hint=damaged_hint(path))  # fmt: skip
    return dataset


def _read_lineage(file: h5py.File, where: str) -> tuple[dict[str, Any], ...]:
    """The steps since the file was collected; none in a file that says nothing about them."""
    if "lineage" not in file.attrs and "lineage" not in file:
        return ()
    steps = layout.read_json(file, "lineage", where)["steps"]
    return tuple({**step, "from": [str(hash) for hash in step["from"]]} for step in steps)


def _read_tasks(present: dict[str, h5py.Dataset], family: str) -> tables.Tasks:
    values = _columns(present, layout.TASKS)
    names: tuple[str, ...] = values["name"]
    known = {task.name: task.index for task in FAMILIES[family].tasks} if family in FAMILIES else {}
    return tables.Tasks(
        names=names,
        indices=tuple(known.get(name, row) for row, name in enumerate(names)),
        envs=tuple(layout.parse_json(text, "/tasks/env") for text in values["env"]),
        roles=values["role"],
        references=tuple(references_of(values, row) for row in range(len(names))),
    )


def _read_stats(group: h5py.Group, where: str) -> tables.Stats:
    fields = {}
    for name in layout.STATS_FIELDS:
        columns = tuple(layout.Column(stat, "<f8", (name,)) for stat in layout.STATS)
        if name not in group:
            raise FormatError(f"group /stats/{name} is missing", where=where)
        fields[name] = _columns(layout.check_group(group[name], columns, {}, where), columns)
    constant = layout.read_json(group, "constant", where)
    return tables.Stats(
        fields=fields,
        slice=layout.read_text(group, "slice", where),
        tasks_seen=tuple(int(row) for row in group.attrs["tasks_seen"]),
        constant={name: tuple(columns) for name, columns in constant.items()},
    )


def _read_tta(
    name: str, group: h5py.Group, sizes: dict[str, int] | None, where: str, arrays: _Arrays
) -> tables.TtaSet:
    own = None if sizes is None else {letter: sizes[letter] for letter in "DA"}
    found = {
        key: layout.check_group(group[key] if key else group, columns, own, where)
        for key, columns in layout.TTA_GROUPS.items()
    }
    return tables.TtaSet(
        name=name,
        rule=layout.read_json(group, "rule", where),
        content_hash=layout.read_text(group, "content_hash", where),
        **_columns(found["steps"], layout.TTA_STEPS, arrays),
        **_columns(found["episodes"], layout.TTA_EPISODES),
    )
