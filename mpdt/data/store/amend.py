"""Add a slice, a TTA set or references to a finished file: a changed copy takes its place.

The episodes, and with them the content hash, stay what they are. The file is held from before
it is read until the copy has its place, so that what two processes add at once is both in it.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mpdt.data.reference import References
from mpdt.data.store import columns, layout
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.digest import content_header
from mpdt.data.store.inherit import task_rows
from mpdt.data.store.proof import check_digests
from mpdt.data.store.reader import open_dataset, read_file
from mpdt.data.store.seal import seal
from mpdt.data.store.sources import TtaSource
from mpdt.data.store.tables import Int64, Slice
from mpdt.data.store.ttaset import fill_tta
from mpdt.data.store.writer import ALIGNED, closing, write_references, write_slice
from mpdt.disk import disk, holding, replacing, reserve


def add_slice(
    path: Path, name: str, ids: Int64 | Sequence[int], rule: Mapping[str, Any]
) -> Dataset:
    """Add a named slice, or replace the one of that name, and open the new file.

    The slice that is there already leaves the file as it is, to the byte.

    Args:
        ids: ascending absolute episode ids.
        rule: how they were chosen; stored as JSON.
    Raises: DataError for ids that do not ascend inside the file; UsageError for a bad name;
        BusyError, StorageError. The old file stays on any of these.
    """
    asked = np.asarray(ids, np.int64)
    with holding(path, amends=True):
        there = open_dataset(path)
        is_there = name in there.slices and np.array_equal(there.slices[name], asked)
        if is_there and dict(there.slice_rules[name]) == dict(rule):
            return there
        with _copy(path) as (file, dataset), disk(path):
            if name in file.get("slices", {}):
                del file["slices"][name]
            write_slice(file, name, Slice(asked, rule), dataset)
        return open_dataset(path)


def add_tta(path: Path, name: str, source: TtaSource) -> Dataset:
    """Add a TTA set, or replace the one of that name, and open the new file.

    Raises: as `writer.write_file`.
    """
    with holding(path, amends=True):
        with _copy(path, name) as (file, dataset):
            layout.checked_name(name)
            success = dataset.steps.successes is not None
            sizes = {"D": dataset.observation_size, "A": dataset.action_size}
            counts = {"N": source.num_steps, "E": source.num_episodes}
            with disk(path):
                if name in file.get("tta", {}):
                    del file["tta"][name]
                group = file.create_group(f"tta/{name}")
                wanted = columns.step_columns(tta=True, has_success=success)
                table = columns.open_steps(group, wanted, sizes | counts, path)
                file.flush()
                reserve(Path(file.filename), Path(file.filename).stat().st_size)
            tasks = columns.TaskIndex(task_rows(dataset), str(path))
            goals = columns.GoalTable.of(dataset.goals)
            content = content_header(dataset.family, dataset.tasks.names, sizes["D"], sizes["A"],
                                     success)  # fmt: skip
            fill_tta(group, table, source, content, tasks, goals)
            with disk(path):
                del file["goals"]
                columns.write_table(file.create_group("goals"), layout.GOALS, goals.values())
        return open_dataset(path)


def set_references(path: Path, references: Mapping[str, References]) -> Dataset:
    """Enter references by task name, in place of those that the tasks have; open the new file.

    Raises: UsageError for a task that is not in the file; BusyError, StorageError. The old file
        stays on any of these.
    """
    with holding(path, amends=True):
        with _copy(path) as (file, dataset), disk(path):
            write_references(file, references, dataset)
        return open_dataset(path)


@contextmanager
def _copy(path: Path, but: str = "") -> Iterator[tuple[h5py.File, Dataset]]:
    """A changed copy of a file that is held, once it is known to be whole.

    Args:
        but: a TTA set that is going to be replaced, whatever is in it.
    """
    dataset = open_dataset(path)
    with replacing(path) as temporary:
        with disk(path):
            shutil.copyfile(path, temporary)
        copied = read_file(temporary)  # its seal as well, or a new one would cover up damage
        check_digests(copied, path, [name for name in copied.tta if name != but])
        with disk(path):
            file = h5py.File(temporary, "r+", **ALIGNED)
        with closing(file, path):
            yield file, dataset
            with disk(path):
                seal(file)
        read_file(temporary)
