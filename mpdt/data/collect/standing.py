"""Standing: by what entry a file's family makes more of it, also where it was not collected.

    collected file   its own entry
    imported file    the entry that mpdt ships under the family's name, with the file's horizon,
                     options and tasks: its seed, its behaviour, its references

So a set for test-time adaptation of an import is the one that a collection of the shipped entry
has, and its references are those on record for the same tasks, horizon and options. None of it says
that the import's episodes came from this simulator.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import msgspec

from mpdt.data.collect.job import make_job
from mpdt.data.collect.levels import measure_levels
from mpdt.data.reference import References
from mpdt.data.sim.simulators import not_installed
from mpdt.data.spec.catalog import shipped_catalog
from mpdt.data.spec.entry import DatasetSpec, EpisodeCounts
from mpdt.data.spec.recorded import Recorded
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.sources import FileHeader
from mpdt.errors import DataError, MpdtError


def standing_spec(dataset: Dataset) -> DatasetSpec:
    """The entry under which more of this file is made.

    Raises: DataError for a file that was neither collected nor imported into a known family;
        SimulatorError for a family whose simulator is not here.
    """
    if dataset.definition and not (family := dataset.contract()).simulates:
        raise not_installed(family)
    if dataset.definition and isinstance(family.env, Recorded):
        raise DataError("nothing more is made of a family that an import made",
                        where=str(dataset.path), expected="zero and random, measured at the import",
                        hint="a module of your own under `families` in datasets.yaml, and an entry "
                        "of it, are collected, adapted to and measured as any other")  # fmt: skip
    try:
        return msgspec.convert(dict(dataset.spec), DatasetSpec)
    except msgspec.ValidationError as error:
        found = str(error)
    where = str(dataset.path)
    if "import" not in dataset.spec:
        what = "the file does not say how it was made"
        if "policy" in dataset.spec:
            what, found = "nothing more is made of a policy's episodes", ""
        raise DataError(what, where=where, found=found,
                        hint="only files of `mpdt-data collect` and of `mpdt-data import` can get "
                             "more")  # fmt: skip
    horizon, env = dataset.spec.get("horizon"), dict(dataset.spec.get("env") or {})
    try:
        return imported_spec(dataset.family, dataset.tasks.names, horizon, env)
    except (MpdtError, TypeError, msgspec.ValidationError) as error:
        raise DataError("its family makes nothing like it", where=where,
                        found=str(error)) from error  # fmt: skip


def imported_spec(
    family: str, tasks: Sequence[str], horizon: int | None, env: Mapping[str, float | bool]
) -> DatasetSpec:
    """The shipped entry of a family with a file's own tasks, horizon and options.

    Args:
        horizon: None = the entry's.
    Raises: UsageError for a family without an entry; SpecError for tasks or options it has not.
    """
    entry = shipped_catalog().get(family)
    return msgspec.structs.replace(
        entry, tasks=tuple(tasks), horizon=horizon or entry.horizon, env=dict(env)
    )


def recorded_references(spec: DatasetSpec) -> dict[str, References]:
    """What is on record for the tasks of an entry, by name; tasks of which nothing is are left out.

    Raises: as `make_job`.
    """
    plan = make_job(msgspec.structs.replace(spec, episodes=EpisodeCounts())).plan
    return {
        name: levels.references
        for name, levels in measure_levels(plan, []).items()
        if any(one.is_known for one in levels.references.by_name.values())
    }


def with_references(header: FileHeader) -> tuple[FileHeader, list[str]]:
    """The header of an import with the references on record, and what a user should know of it.

    A header that has references keeps them: it is that of an export of ours.
    """
    known = any(task.references.by_name for task in header.tasks)
    if known or "import" not in header.spec:
        return header, []
    names, horizon = [task.name for task in header.tasks], header.spec.get("horizon")
    if header.definition:
        return header, ["references stay unknown: none are on record for a family of one's own; "
                        "sets that are called random or expert give them"]  # fmt: skip
    if horizon is None:
        return header, ["references stay unknown: nothing says after how many steps episodes end"]
    try:
        spec = imported_spec(header.family, names, horizon, header.spec.get("env") or {})
        found = recorded_references(spec)
    except MpdtError as error:
        return header, [f"references stay unknown: {error.message()}"]
    missing = [name for name in names if name not in found]
    remarks = [f"no references on record at {horizon} steps: {', '.join(missing[:3])}"
               f"{' ...' * (len(missing) > 3)}; `mpdt-data reference FILE` measures them"
               ] if missing else []  # fmt: skip
    tasks = [replace(task, references=found.get(task.name, task.references))
             for task in header.tasks]  # fmt: skip
    return replace(header, tasks=tasks), remarks
