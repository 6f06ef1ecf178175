"""What a program needs of the data layer: `mpdt.open`, `mpdt.collect`, `mpdt.windows`."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from operator import index
from pathlib import Path
from typing import SupportsIndex

import msgspec

from mpdt.data.collect.collect import collect as collect_job
from mpdt.data.collect.job import make_job
from mpdt.data.slices.sampler import SamplerSettings, WindowSampler
from mpdt.data.slices.several import open_files, open_ref
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.spec.entry import DatasetSpec
from mpdt.data.spec.smoke import smoke as smoke_version
from mpdt.data.store.dataset import Dataset
from mpdt.errors import UsageError

_SETTINGS = SamplerSettings()


def open(path: Path | str | Sequence[Path | str], preload: bool = False) -> Dataset:
    """Open a finished file, or several of one family as if they were merged; see `Dataset`.

    Args:
        path: a file, a folder, a pattern such as `parts/*.h5`, or a list of those.
        preload: copy the step arrays to RAM instead of mapping them.
    Raises: MissingFileError, FormatError, StorageError; DataError for files that cannot be one,
        as `merge` refuses them.
    """
    return open_files(path, preload)


def collect(
    spec: DatasetSpec | str,
    target: Path | str | None = None,
    *,
    tasks: Sequence[str | int] = (),
    workers: int | None = None,
    restart: bool = False,
    smoke: bool = False,
    tiny: bool | None = None,
) -> Dataset:
    """Make a dataset, or go on with an interrupted collection of it; `mpdt-data collect`.

    Args:
        spec: an entry, or the name of one in ./datasets.yaml or else the shipped one.
        target: the file; None = NAME.h5 in the working folder.
        tasks: only these, by name or index.
        workers: processes; None = one per core, which needs `if __name__ == "__main__":` in a
            script; 0 = in this process.
        restart: begin anew and replace what is there.
        smoke: a tiny version with the same tasks, as NAME-smoke.
        tiny: the former name of `smoke`.
    Remarks come as UserWarning. Raises: as `make_job` and `collect.collect`.
    """
    if tiny is not None:
        warnings.warn("collect(tiny=) is called smoke= now, as in the command line",
                      DeprecationWarning, stacklevel=2)  # fmt: skip
        smoke = tiny
    if isinstance(spec, str):
        spec = load_catalog().get(spec)
    if tasks:
        spec = msgspec.structs.replace(spec, tasks=tuple(tasks))
    if smoke:
        spec = smoke_version(spec)
    path = Path(f"{spec.name}.h5" if target is None else target)
    done = collect_job(make_job(spec), path, workers=workers, restart=restart)
    for remark in done.warnings:
        warnings.warn(remark, UserWarning, stacklevel=2)
    return done.dataset


_MOST = 100_000
"""Windows of a task in a batch, and their steps."""


def windows(
    data: Dataset | Path | str | Sequence[Path | str],
    *,
    window: int = _SETTINGS.window,
    per_task: int = _SETTINGS.per_task,
    seed: int = 0,
    tasks: str | Sequence[str | SupportsIndex] = (),
    quality: str | Sequence[str] | None = None,
) -> WindowSampler:
    """Batches of windows as a function of (seed, step): `windows(...).batch(step)`.

    Args:
        data: an open dataset, FILE or FILE:slice, where FILE is all that `open` takes.
        window: K of the batch's shapes (n tasks, M, K, ...).
        per_task: M of them.
        tasks: names or rows; none = the training tasks.
        quality: random, medium, expert, history, policy, or several; None = all.
    Raises: UsageError for unknown names, a task that is named twice and numbers out of range;
        TypeError for what is no whole number; DataError if a task has no such episode; as `open`.
    """
    window, per_task, seed = index(window), index(per_task), index(seed)
    for name, number, least, most in (
        ("window", window, 1, _MOST), ("per_task", per_task, 1, _MOST),
        ("seed", seed, 0, 2**63 - 1),
    ):  # fmt: skip
        if not least <= number <= most:
            raise UsageError("out of range", where=f"windows({name}=)", found=str(number),
                             expected=f"{least} to {most:,}")  # fmt: skip
    part: str | None = None
    if not isinstance(data, Dataset):
        data, part = open_ref(data)
    named = [tasks] if isinstance(tasks, str) else tasks
    rows = [data.task_row(task) for task in named] or data.tasks.train_rows
    if len(set(rows)) < len(rows):
        raise UsageError("a task is named twice", where="windows(tasks=)",
                         found=", ".join(data.tasks.names[row] for row in rows))  # fmt: skip
    ids = {row: data.select(task=row, quality=quality, slice=part) for row in rows}
    return WindowSampler(data, ids, rows, window, per_task, seed)
