"""Merge: the episodes of several files of one family in one file, each once, in canonical order.

    a.h5   task 0: random 0-199                    c.h5   task 0: random 0-199, expert 0-99
    b.h5   task 0: expert 0-99   task 1: ...              task 1: ...

Episodes are told apart by their place (task, quality, block, row) under one root seed: equal
bytes at one place are one episode, other bytes are a contradiction and refused. Merging the
cut-outs of a file gives the content hash of that file again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mpdt.data.episode import Episode, PolicyInfo
from mpdt.data.reference import References
from mpdt.data.slices.cut import refuse_to_replace
from mpdt.data.slices.merge_claims import imports, statements
from mpdt.data.slices.merge_tta import merged_tta
from mpdt.data.slices.places import Places, find_places
from mpdt.data.slices.standard import standard_additions
from mpdt.data.spec.change import changed_keys
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.inherit import header_of, lineage_step, task_rows
from mpdt.data.store.licence import combined
from mpdt.data.store.proof import proven
from mpdt.data.store.sources import EpisodeSource, FileHeader
from mpdt.data.store.tables import Int64, TaskRow
from mpdt.data.store.writer import write_file
from mpdt.disk import holding
from mpdt.errors import DataError, UsageError

SAME = ("family", "seed", "horizon", "block", "env", "goals", "behaviour")
"""Keys of the spec that decide what an episode at a place is."""


@dataclass(frozen=True)
class Merged:
    """The new file, and how many episodes were in more than one source."""

    dataset: Dataset
    num_repeated: int


def merge(sources: Sequence[Dataset], target: Path) -> Merged:
    """Write all episodes of `sources` to `target` and open it.

    Name, version and package versions are those of the first source; the licence asks for what
    any source asks for; the spec gains the others' tasks, files and the larger number of episodes.
    `parent` is the common parent of cut-outs of one file, with ids of that file as `source`; else
    the first source. The lineage names all, and what each said where they did not say the same.
    Slices are the standard ones; statistics are computed anew.

    Raises: UsageError for fewer than two sources; DataError where families, seeds or bytes
        contradict each other, or as `refuse_to_replace`; BusyError, StorageError.
    """
    if len(sources) < 2:
        raise UsageError("merge needs at least two files")
    with holding(target):
        refuse_to_replace(sources, target, {"verb": "merge"})
        return _merge(sources, target)


def _merge(sources: Sequence[Dataset], target: Path) -> Merged:
    for source in sources:
        check_kin(sources[0], source)
    places, header = find_places(sources), merged_header(sources)

    dataset = write_file(
        target,
        header,
        _episodes(sources, places),
        merged_tta(sources, [task.index for task in header.tasks]),
        standard_additions,
    )
    return Merged(dataset, places.num_repeated)


def check_kin(first: Dataset, other: Dataset) -> None:
    """Can episodes of both stand in one file? Raises: DataError."""
    own = [d.definition.get("fingerprint") for d in (first, other)]
    shapes = [
        d.content_header() | {"tasks": None, "definition": fingerprint}
        for d, fingerprint in zip((first, other), own, strict=True)
    ]
    keys = [{key: d.spec.get(key) for key in SAME} for d in (first, other)]
    if changes := changed_keys(shapes[0], shapes[1]) + changed_keys(keys[0], keys[1]):
        raise DataError(
            f"not made for one file: {'; '.join(changes)}",
            where=f"{first.path} and {other.path}",
            hint="collect one entry with all you need",
        )


def _episodes(sources: Sequence[Dataset], places: Places) -> EpisodeSource:
    def read() -> Iterator[Episode]:
        for source, i in zip(places.source.tolist(), places.id.tolist(), strict=True):
            yield proven(sources[source], i)

    steps = int(places.column([source.episodes.length for source in sources]).sum(dtype=np.int64))
    ids = source_ids(sources, places)
    return EpisodeSource(read(), len(places), steps, None if ids is None else ids.tolist())


def source_ids(sources: Sequence[Dataset], places: Places) -> Int64 | None:
    """Ids in the common parent; None unless all sources were cut out of one and say which."""
    columns = [source.episodes.source for source in sources]
    known = [column for column in columns if column is not None]
    return places.column(known) if _parent(sources)[1] and len(known) == len(columns) else None


def _parent(sources: Sequence[Dataset]) -> tuple[str, bool]:
    """Content hash of the parent, and whether all sources were cut out of it."""
    parents = {source.parent for source in sources}
    if len(parents) == 1 and (common := parents.pop()):
        return common, True
    return sources[0].content_hash, False


def merged_header(sources: Sequence[Dataset]) -> FileHeader:
    """What a file of all their episodes says about itself.

    Raises: DataError for one task of two names or roles, and for two figures of one reference.
    """
    tasks: dict[int, TaskRow] = {}
    policies: dict[tuple[int, bytes], PolicyInfo] = {}
    for source in sources:
        for task in task_rows(source):
            known = tasks.setdefault(task.index, task)
            if (known.name, known.role) != (task.name, task.role):
                raise DataError(f"task {task.index} is {known.name} ({known.role}) and "
                                f"{task.name} ({task.role})",
                                where=f"{sources[0].path} and {source.path}")  # fmt: skip
            where = f"{sources[0].path} and {source.path}"
            if known.references.by_name:
                task = replace(known, references=_both(known, task, where))
            tasks[task.index] = task
        for policy in source.policy_infos():
            policies.setdefault((policy.task, policy.hash), policy)
    first = sources[0]
    step = lineage_step({"verb": "merge"}, *sources)
    if any(source.lineage for source in sources):
        step |= {"before": [[dict(old) for old in source.lineage] for source in sources]}
    if said := statements(sources):
        step |= {"sources": said}
    return replace(
        header_of(first),
        license=combined(source.license for source in sources),
        spec=_spec(sources),
        tasks=[tasks[index] for index in sorted(tasks)],
        policies=sorted(policies.values(), key=lambda policy: policy.task),
        parent=_parent(sources)[0],
        lineage=[step],
    )


def _both(one: TaskRow, two: TaskRow, where: str) -> References:
    """What either knows of a task. Raises: DataError for a reference with two mean returns."""
    known, more = one.references, two.references
    for name, reference in more.by_name.items():
        other = known[name]
        if other.is_known and reference.is_known and other.mean != reference.mean:
            raise DataError(
                f"two figures for the reference {name} of {one.name}", where=where,
                expected="one, for returns are compared with it",
                found=f"{other.mean:g} and {reference.mean:g}",
                hint="mpdt-data reference FILE measures those of a file again",
            )  # fmt: skip
    new = {name: reference for name, reference in more.by_name.items() if not known[name].is_known}
    action = known.constant_action
    if "constant" in new or not action:
        action = more.constant_action or action
    return References({**known.by_name, **new}, action)


def _spec(sources: Sequence[Dataset]) -> Mapping[str, Any]:
    """The first spec with every source's tasks, and the larger number of each kind of episode."""
    merged = dict(sources[0].spec)
    for source in sources[1:]:
        spec = source.spec
        if spec.get("tasks") != merged.get("tasks"):
            merged["tasks"] = _all_tasks(merged.get("tasks"), spec.get("tasks"))
        if isinstance(counts := spec.get("episodes"), Mapping):
            own = merged.get("episodes", {})
            merged["episodes"] = {
                name: max(counts.get(name, 0), own.get(name, 0)) for name in {*counts, *own}
            }
        if isinstance(sets := spec.get("tta"), Mapping):
            merged["tta"] = dict(sets) | dict(merged.get("tta", {}))
    if "license" in merged:
        merged["license"] = combined(source.license for source in sources)
    if (found := imports(sources)) is not None:
        merged["import"] = found
    return merged


def _all_tasks(one: Any, two: Any) -> Any:
    if "all" in (one, two) or not (isinstance(one, list) and isinstance(two, list)):
        return "all"
    return [*one, *(task for task in two if task not in one)]
