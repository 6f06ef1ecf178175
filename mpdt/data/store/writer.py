"""Write a file of episodes in one pass: streaming, atomic, checked before it is believed.

    header + announced counts -> preallocated arrays -> episodes one by one -> tables
      -> read back, digests compared -> `finish` adds slices, stats -> `complete` -> rename

Memory holds some megabytes of episodes and about 150 bytes per episode. The old file at the
target stays untouched until the new one is on the disk.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from mpdt.data.reference import References
from mpdt.data.spec.entry import canonical_json, spec_hash
from mpdt.data.store import columns, layout, provenance
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.digest import content_hash, episode_digest
from mpdt.data.store.proof import check_digests
from mpdt.data.store.reader import open_dataset, read_file
from mpdt.data.store.references import reference_cells
from mpdt.data.store.seal import seal
from mpdt.data.store.sources import EpisodeSource, FileHeader, TtaSource
from mpdt.data.store.tables import Additions, Slice, Stats, TaskRow
from mpdt.data.store.ttaset import fill_tta
from mpdt.disk import disk, holding, replacing, reserve
from mpdt.errors import DataError

__all__ = ["Additions", "EpisodeSource", "FileHeader", "Slice", "Stats", "TaskRow", "TtaSource",
           "check_digests", "write_file"]  # fmt: skip

_CHANGED = "the disk or a program changed them while they were written; try again"
_TABLES, _PER_EPISODE = 1 << 20, 512
"""Bytes looked for beside the steps, for tables, slices, seal and what HDF5 adds: shipped families
take 135 to 222 an episode, the smallest file 86 kB in all (2026-11-30)."""
ALIGNED = {"alignment_threshold": 1, "alignment_interval": layout.ALIGNMENT_BYTES}
"""Without it HDF5 packs a float array right behind an odd number of bool bytes."""


def write_file(
    target: Path,
    header: FileHeader,
    source: EpisodeSource,
    tta: Mapping[str, TtaSource] | None = None,
    finish: Callable[[Dataset], Additions] | None = None,
) -> Dataset:
    """Write a complete file to `target`, replacing what was there, and open it.

    Args:
        finish: called with the readable but nameless temporary file once all episodes are in
            (its `path` ends in `.tmp`); returns slices, statistics and reference returns.
    Raises: StorageError where the disk refuses; BusyError if another process writes or wrote
        `target` meanwhile; DataError or ShapeError for episodes that do not fit header, order
        or counts; whatever `source` or `finish` raise. In all of these the old file is
        untouched and no temporary file is left.
    """
    with holding(target):
        with replacing(target) as temporary:
            with disk(target):
                file = h5py.File(temporary, "w", **ALIGNED)
            with closing(file, target):
                _fill(file, temporary, target, header, source, tta or {})
            dataset = read_file(temporary, unfinished=True)
            check_digests(dataset, target, hint=_CHANGED)
            additions = finish(dataset) if finish else Additions()
            with disk(target):
                file = h5py.File(temporary, "r+", **ALIGNED)
            with closing(file, target), disk(target):
                _write_additions(file, additions, dataset)
                seal(file)
                file.attrs["complete"] = np.uint8(1)
            read_file(temporary)
        return open_dataset(target)


@contextmanager
def closing(file: h5py.File, target: Path) -> Iterator[h5py.File]:
    """Close an HDF5 file; a failing close counts only where nothing failed before it."""
    try:
        yield file
    except BaseException:
        with suppress(OSError, RuntimeError):
            file.close()
        raise
    with disk(target):
        file.close()


def _fill(
    file: h5py.File, temporary: Path, target: Path,
    header: FileHeader, source: EpisodeSource, tta: Mapping[str, TtaSource],
) -> None:  # fmt: skip
    tasks = columns.TaskIndex(header.tasks, str(target))
    sizes = {"D": header.observation_size, "A": header.action_size}

    def steps(path: str, of: EpisodeSource | TtaSource) -> columns.StepTable:
        wanted = columns.step_columns(isinstance(of, TtaSource), header.has_success)
        counts = {"N": of.num_steps, "E": of.num_episodes}
        return columns.open_steps(file.create_group(path), wanted, sizes | counts, target)

    with disk(target):
        # Everything large gets its place before the first episode is asked for.
        main = steps("steps", source)
        sets = {name: steps(f"tta/{layout.checked_name(name)}", tta[name]) for name in tta}
        file.flush()
        episodes = source.num_episodes + sum(one.num_episodes for one in tta.values())
        reserve(temporary, temporary.stat().st_size, _TABLES + _PER_EPISODE * episodes)
    goals = columns.GoalTable()
    digests = _append_episodes(file, main, header, source, tasks, goals, target)
    for name in tta:
        fill_tta(file[f"tta/{name}"], sets[name], tta[name], header.content(), tasks, goals)
    with disk(target):
        for key in ("family", "name", "version", "license", "parent"):
            layout.write_text(file, key, getattr(header, key))
        if header.lineage:
            layout.write_json(file, "lineage", {"steps": [dict(step) for step in header.lineage]})
        if header.definition:
            layout.write_json(file, "definition", header.definition)
        file.attrs["format"] = layout.FORMAT
        layout.write_json(file, "spec", header.spec)
        file.attrs["spec_hash"] = spec_hash(header.spec)
        file.attrs["content_hash"] = content_hash(header.content(), digests)
        layout.write_json(file, "packages", header.packages or provenance.packages())
        layout.write_json(file, "platform", header.platform or provenance.machine())
        _write_tasks_and_policies(file, header, tasks)
        columns.write_table(file.create_group("goals"), layout.GOALS, goals.values())


def _append_episodes(
    file: h5py.File, table: columns.StepTable, header: FileHeader, source: EpisodeSource,
    tasks: columns.TaskIndex, goals: columns.GoalTable, target: Path,
) -> NDArray[np.uint8]:  # fmt: skip
    policies = {(policy.task, policy.hash): row for row, policy in enumerate(header.policies)}
    extra: dict[str, array[Any]] = {
        "policy": array("q"), "quality": array("q"), "progress": array("d"),
        "return": array("d"), "success": array("b"),
    }  # fmt: skip
    digests = bytearray()
    for episode in source.episodes:
        row, policy = tasks.row(episode.task), policies.get((episode.task, episode.policy))
        if policy is None:
            raise DataError("episode of a policy the header does not list", where=str(target),
                            found=f"task {episode.task}, {episode.policy.hex()[:12]}")  # fmt: skip
        with disk(target):
            table.append(episode, row, goals.row(row, episode.goal))
        digests += episode_digest(episode, tasks.name(episode.task))
        values = (policy, episode.quality, episode.progress, episode.episode_return,
                  episode.success)  # fmt: skip
        for column, value in zip(extra.values(), values, strict=True):
            column.append(value)
    found = np.frombuffer(digests, np.uint8).reshape(-1, 32)
    values_by_name: dict[str, Any] = table.finish() | extra | {"digest": found}
    values_by_name["source"] = source.source_ids
    if source.source_ids is not None and len(source.source_ids) != len(found):
        raise DataError("source ids and episodes disagree", where=str(target),
                        expected=str(len(found)), found=str(len(source.source_ids)))  # fmt: skip
    with disk(target):
        group = file.create_group("episodes")
        columns.write_table(group, layout.EPISODES, values_by_name)
        codes = canonical_json(layout.quality_codes(set(extra["quality"]))).decode()
        group["quality"].attrs["codes"] = codes
    return found


def _write_tasks_and_policies(
    file: h5py.File, header: FileHeader, tasks: columns.TaskIndex
) -> None:
    rows = header.tasks
    values: dict[str, Any] = {
        "name": [row.name for row in rows],
        "env": [canonical_json(row.env).decode() for row in rows],
        "role": [layout.ROLE_CODES[row.role] for row in rows],
    }
    for task in rows:
        cells = reference_cells(task.references, header.action_size)
        for path, value in cells.items():
            values.setdefault(path, []).append(value)
    columns.write_table(file.create_group("tasks"), layout.TASKS, values)
    policies = header.policies
    hashes = np.frombuffer(b"".join(policy.hash for policy in policies), np.uint8)
    values = {"hash": hashes.reshape(-1, 32), "task": [tasks.row(p.task) for p in policies]}
    for name in ("rung", "level", "train_step", "mix_rate", "name"):
        values[name] = [getattr(policy, name) for policy in policies]
    columns.write_table(file.create_group("policies"), layout.POLICIES, values)


def _write_additions(file: h5py.File, additions: Additions, dataset: Dataset) -> None:
    for name, chosen in additions.slices.items():
        write_slice(file, name, chosen, dataset)
    if additions.stats is not None:
        write_stats(file, additions.stats)
    write_references(file, additions.references, dataset)


def write_references(
    file: h5py.File, references: Mapping[str, References], dataset: Dataset
) -> None:
    """Enter references by task name, in place of older ones. Raises: UsageError for a task."""
    for task, one in references.items():
        row = dataset.task_row(task)
        for path, value in reference_cells(one, dataset.action_size).items():
            file[f"tasks/{path}"][row] = value


def write_slice(file: h5py.File, name: str, chosen: Slice, dataset: Dataset) -> None:
    """Add one slice to an open file.

    Raises: DataError unless the ids ascend inside the file.
    """
    ids = np.asarray(chosen.ids, np.int64)
    inside = len(ids) == 0 or (ids[0] >= 0 and ids[-1] < dataset.num_episodes)
    if ids.ndim != 1 or not inside or (np.diff(ids) <= 0).any():
        raise DataError(f"slice '{name}' needs ascending episode ids", where=str(dataset.path),
                        expected=f"0 to {dataset.num_episodes - 1}",
                        found=f"{ids.tolist()[:6]} of {ids.size}")  # fmt: skip
    group = file.require_group("slices")
    kept = group.create_dataset(layout.checked_name(name), data=ids.astype("<i8"))
    layout.write_json(kept, "rule", dict(chosen.rule))
    kept.attrs["parent"] = dataset.content_hash


def write_stats(file: h5py.File, stats: Stats) -> None:
    """Add `/stats` to an open file, in place of older ones."""
    if "stats" in file:
        del file["stats"]
    group = file.create_group("stats")
    for name in layout.STATS_FIELDS:
        values = stats.fields[name]
        shape = layout.Column("", "<f8", (values["mean"].size,)).shape
        table = [layout.Column(stat, "<f8", shape) for stat in layout.STATS]
        columns.write_table(group.create_group(name), table, dict(values))
    layout.write_text(group, "slice", stats.slice)
    group.attrs["tasks_seen"] = np.asarray(stats.tasks_seen, "<i4")
    constant = {name: list(stats.constant.get(name, ())) for name in layout.STATS_FIELDS}
    layout.write_json(group, "constant", constant)
