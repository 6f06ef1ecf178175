"""Split: apply one cut to a file, to every task of it, or to every family file of a folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from mpdt.data.slices.cut import Cut, choose, cut_file, task_rows
from mpdt.data.store.amend import add_slice
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset, parse_ref
from mpdt.disk import holding
from mpdt.errors import DataError, FormatError, MissingFileError, UsageError

VALIDATION = "validation"
"""Name of the slice that is held out, unless another is asked for."""


@dataclass(frozen=True)
class CutOut:
    """One result of `split`: a new file, or a new slice inside `path`."""

    path: Path
    slice: str | None
    source: Path
    num_episodes: int
    num_steps: int


def split(
    file: str | None,
    cut: Cut,
    *,
    per_task: bool = False,
    name: str | None = None,
    output: Path | None = None,
    folder: Path | None = None,
    on_skip: Callable[[str], None] | None = None,
) -> list[CutOut]:
    """Cut `file`, or every finished family file in `folder`.

    Args:
        file: FILE or FILE:slice; None = every file of `folder` that is not itself a cut-out.
        per_task: one file per task that has episodes left.
        name: add a slice of this name to the file instead of writing another file.
        output: where to write; default `<file><cut>.h5` beside the source.
        folder: default: the working folder.
        on_skip: told about each file of `folder` that is left out, and why.

    Raises: UsageError for options that do not go together; MissingFileError without any
        file; DataError where no episode fits; StorageError.
    """
    if cut.by is not None and cut.validation is None:
        raise UsageError("--by says how --validation holds out", hint="add --validation 0.1")
    if cut.validation is not None:
        name = name or VALIDATION
    if name is not None and (per_task or output is not None):
        what = "--validation" if cut.validation is not None else "--name"
        raise UsageError(f"{what} adds a slice to the file: no --per-task and no -o with it")
    if file is not None:
        path, slice_name = parse_ref(file)
        cut = replace(cut, slice=slice_name)
        _refuse_empty(cut, per_task)
        return _split_one(open_dataset(path), cut, per_task, name, output)
    if output is not None:
        raise UsageError("-o needs to know which file", hint="mpdt-data split FILE ... -o OUTPUT")
    _refuse_empty(cut, per_task)
    results: list[CutOut] = []
    problem: DataError | None = None
    for dataset in family_files(folder or Path(), on_skip):
        try:
            results += _split_one(dataset, cut, per_task, name, None)
        except DataError as error:
            problem = error
            if on_skip is not None:
                on_skip(error.message())
    if problem is not None and not results:
        raise problem
    return results


def family_files(folder: Path, on_skip: Callable[[str], None] | None = None) -> list[Dataset]:
    """Every finished file in `folder` that was collected, not cut out, by name.

    Raises: MissingFileError if there is none.
    """
    found = []
    for path in sorted(folder.glob("*.h5")):
        try:
            dataset = open_dataset(path)
        except FormatError as error:
            if on_skip is not None:
                on_skip(error.message())
            continue
        if not dataset.parent:
            found.append(dataset)
    if not found:
        raise MissingFileError(
            "no dataset file here",
            where=str(folder.resolve()),
            hint="make one: mpdt-data collect cheetah_dir; or name it: mpdt-data split FILE",
        )
    return found


def _refuse_empty(cut: Cut, per_task: bool) -> None:
    if not cut.rule() and not per_task:
        raise UsageError(
            "nothing to cut by",
            hint="give at least one of --quality, --tasks, --train, --test, --progress, "
            "--return-top, --episodes, --per-task, --validation or FILE:slice",
        )


def _split_one(
    dataset: Dataset, cut: Cut, per_task: bool, name: str | None, output: Path | None
) -> list[CutOut]:
    path = dataset.path
    if name is not None:
        with holding(path, amends=True):
            dataset = open_dataset(path)  # another process may have written it meanwhile
            ids = choose(dataset, cut)
            add_slice(path, name, ids, cut.rule())
        steps = int(dataset.episodes.length[ids].sum())
        return [CutOut(path, name, path, len(ids), steps)]
    target = output or path.with_name(f"{path.stem}{cut.suffix()}.h5")
    if not per_task:
        return [_written(cut_file(dataset, cut, target), path)]
    with_episodes = set(dataset.episodes.task[choose(dataset, cut)].tolist())
    results = []
    for row in task_rows(dataset, cut):
        if row in with_episodes:
            task = dataset.tasks.names[row]
            one = target.with_name(f"{target.stem}-{task}{target.suffix}")
            results.append(_written(cut_file(dataset, replace(cut, tasks=(task,)), one), path))
    return results


def _written(dataset: Dataset, source: Path) -> CutOut:
    return CutOut(dataset.path, None, source, dataset.num_episodes, dataset.num_steps)
