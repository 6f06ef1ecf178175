"""Join: several files read as the one that `merge` would make of them, which is never written.

    a.h5 + b.h5  ->  tables in memory, as merge orders them
                     steps: rows of the maps of a and b, copied by nobody

Every public part is that of the merged file, to the last bit: content hash, episodes and their
ids, slices, statistics, TTA sets. So windows drawn of it and what is trained on it are the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from mpdt.data.slices.merge import check_kin, merged_header, source_ids
from mpdt.data.slices.merge_tta import in_order, longest_sets
from mpdt.data.slices.places import Places, find_places
from mpdt.data.slices.standard import standard_slices
from mpdt.data.slices.stats import later_stats
from mpdt.data.spec.entry import canonical_json, spec_hash
from mpdt.data.store import layout, tables
from mpdt.data.store.columns import GoalTable
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.digest import content_hash
from mpdt.data.store.opening import Sources
from mpdt.data.store.rows import JoinedRows
from mpdt.data.store.shown import Slices
from mpdt.data.store.sources import FileHeader
from mpdt.data.store.tables import Int64
from mpdt.errors import DataError, StorageError
from mpdt.reading import decode_json


@dataclass(frozen=True, eq=False)
class Joined(Dataset):
    """Several files as one dataset. A pickle of it holds their paths and what is in them."""

    places: Places = field(kw_only=True, repr=False)
    tta_places: dict[str, Places] = field(kw_only=True, repr=False)

    def in_files(self, ids: Int64) -> list[tuple[Dataset, Int64]]:
        source, own = self.places.source[ids], self.places.id[ids]
        return [
            (part, np.sort(own[source == number]))
            for number, part in enumerate(self.parts)
            if (source == number).any()
        ]

    def tta_in_files(self, name: str) -> list[tuple[Dataset, Int64]]:
        at = self.tta_places[name]
        cuts = np.flatnonzero(np.diff(at.source)) + 1
        pairs = zip(np.split(at.source, cuts), np.split(at.id, cuts), strict=True)
        return [(self.parts[int(source[0])], ids) for source, ids in pairs if len(ids)]

    def __reduce__(self) -> tuple[Any, ...]:
        return _join_again, (tuple(self.parts), self.path, self.content_hash)


def join(parts: Sequence[Dataset], path: Path | None = None) -> Dataset:
    """`parts` as one dataset, in the order in which `merge` would take them.

    Args:
        path: what it is called in messages; None = the paths with commas between them.
    Raises: DataError as `merge`, and for files of one name and several versions.
    """
    for part in parts[1:]:
        check_kin(parts[0], part)
        _check_version(parts[0], part)
    places, header = find_places(parts), merged_header(parts)
    row_of = {task.index: row for row, task in enumerate(header.tasks)}
    rows = [np.array([row_of[index] for index in part.tasks.indices]) for part in parts]
    goals = _Goals(parts, rows)
    episodes = _episodes(parts, places, header, rows, goals)
    names = sorted({name for part in parts for name in part.tta})
    sets = {name: _tta(name, parts, header, rows, goals) for name in names}
    first = parts[0]
    lineage = _stored({"steps": list(header.lineage)})["steps"]
    bare = Joined(
        path=path or Path(",".join(str(part.path) for part in parts)),
        source=Sources([part.source for part in parts]),
        family=header.family, name=header.name, version=header.version, license=header.license,
        spec=_stored(header.spec), spec_hash=spec_hash(header.spec),
        content_hash=content_hash(header.content(), episodes.digest),
        parent=header.parent, lineage=tuple(lineage), definition=header.definition,
        packages=first.packages, platform=first.platform,
        tasks=_tasks(header), policies=_policies(header, row_of), goals=goals.table(),
        episodes=episodes,
        steps=tables.Steps(**_steps(parts, places, [p.steps for p in parts],
                                    [p.episodes for p in parts])),
        slices={}, slice_rules={}, stats_info=None,
        tta={name: one for name, (one, _) in sets.items()},
        tta_places={name: at for name, (_, at) in sets.items()},
        parts=tuple(parts), places=places,
    )  # fmt: skip
    slices = dict(sorted(standard_slices(bare).items()))
    rules = {name: _stored(one.rule) for name, one in slices.items()}
    return replace(
        bare,
        slices=Slices({name: one.ids for name, one in slices.items()}, rules),
        slice_rules=rules,
        stats_info=later_stats(bare),
    )


def _join_again(parts: Sequence[Dataset], path: Path, content: str) -> Dataset:
    """In another process. Raises: StorageError if the files are others by now."""
    dataset = join(parts, path)
    if dataset.content_hash != content:
        raise StorageError("other files took their place since they were opened", where=str(path),
                           hint="open those that are there")  # fmt: skip
    return dataset


def _check_version(first: Dataset, other: Dataset) -> None:
    if first.name == other.name and first.version != other.version:
        raise DataError(
            f"two versions of {first.name}", where=f"{first.path} and {other.path}",
            expected=first.version, found=other.version,
            hint="collect both anew, or put them into one file that says which is which: "
            "mpdt-data merge -h",
        )  # fmt: skip


def _stored(value: Any) -> Any:
    """As a file gives it back: lists for tuples, keys in alphabetical order."""
    return decode_json(canonical_json(value).decode("utf-8"))


class _Goals:
    """One table of all goals, in the order in which the episodes name them first."""

    def __init__(self, parts: Sequence[Dataset], rows: Sequence[Int64]) -> None:
        self._parts, self._rows, self._table = parts, rows, GoalTable()
        sizes = [len(part.goals.tasks) for part in parts]
        self._before = np.cumsum([0, *sizes])

    def of(self, places: Places, columns: Sequence[tables.Int32]) -> Int64:
        """Rows (E,) of the goals that the episodes have in their own files."""
        numbers = [
            column.astype(np.int64) + int(before)
            for column, before in zip(columns, self._before, strict=False)
        ]
        code = places.column(numbers)
        found, first = np.unique(code, return_index=True)
        row = np.empty(int(self._before[-1]), np.int64)
        for one in found[np.argsort(first)].tolist():
            number = int(np.searchsorted(self._before, one, side="right")) - 1
            goals, at = self._parts[number].goals, one - int(self._before[number])
            row[one] = self._table.row(int(self._rows[number][goals.tasks[at]]), goals.of(at))
        return np.asarray(row[code])

    def table(self) -> tables.Goals:
        values = _columns(layout.GOALS, self._table.values())
        return tables.Goals(values["values"], values["dim"], values["task"])


def _columns(columns: Sequence[layout.Column], values: dict[str, Any]) -> dict[str, NDArray[Any]]:
    """Those that are there, in the type of the file."""
    types = {column.path: column.dtype for column in columns}
    return {name: np.asarray(value, types[name]) for name, value in values.items()}


def _episodes(
    parts: Sequence[Dataset], places: Places, header: FileHeader,
    rows: Sequence[Int64], goals: _Goals,
) -> tables.Episodes:  # fmt: skip
    policies = {(p.task, p.hash): row for row, p in enumerate(header.policies)}
    own = [
        np.array([policies[p.task, p.hash] for p in part.policy_infos()], np.int64)
        for part in parts
    ]
    own_tables = [part.episodes for part in parts]

    def column(name: str) -> NDArray[Any]:
        return places.column([getattr(table, name) for table in own_tables])

    length = column("length")
    start = np.cumsum(length, dtype=np.int64) - length
    kept = {name: column(name) for name in ("quality", "progress", "seed_key", "success", "digest")}
    values = _columns(layout.EPISODES, kept | {
        "task": places.column([of[t.task] for of, t in zip(rows, own_tables, strict=True)]),
        "policy": places.column([of[t.policy] for of, t in zip(own, own_tables, strict=True)]),
        "goal": goals.of(places, [table.goal for table in own_tables]),
        "start": start, "obs_start": start + np.arange(len(places)), "length": length,
        "return": column("returns"),
    })  # fmt: skip
    values["returns"] = values.pop("return")
    return tables.Episodes(**values, source=source_ids(parts, places))


def _steps(
    parts: Sequence[Dataset], places: Places, steps: Sequence[Any], own: Sequence[Any]
) -> dict[str, Any]:
    """The step arrays that all of `steps` have, as rows of theirs; None for the others.

    Args:
        steps, own: of each file that counts in `places`, its arrays and where episodes begin.
    """
    length = places.column([table.length for table in own])
    found: dict[str, Any] = {}
    for name in (column.path for column in layout.STEPS):
        arrays = [getattr(one, name, None) for one in steps]
        if any(array is None for array in arrays):
            found[name] = None
            continue
        extra, begin = (1, "obs_start") if name == "observations" else (0, "start")
        first = places.column([getattr(table, begin) for table in own])
        rows = JoinedRows(cast(Any, arrays), places.source, first, length + extra)
        # It reads as an array does; to be one it would have to be a copy of all files.
        found[name] = cast(NDArray[Any], rows)
    return found


def _tasks(header: FileHeader) -> tables.Tasks:
    return tables.Tasks(
        names=tuple(task.name for task in header.tasks),
        indices=tuple(task.index for task in header.tasks),
        envs=tuple(_stored(task.env) for task in header.tasks),
        roles=np.array([layout.ROLE_CODES[task.role] for task in header.tasks], np.int8),
        references=tuple(task.references for task in header.tasks),
    )


def _policies(header: FileHeader, row_of: dict[int, int]) -> tables.Policies:
    rows = header.policies
    names = ("rung", "level", "train_step", "mix_rate")
    values = _columns(layout.POLICIES, {
        "hash": np.frombuffer(b"".join(p.hash for p in rows), np.uint8).reshape(-1, 32),
        "task": [row_of[p.task] for p in rows],
        **{name: [getattr(p, name) for p in rows] for name in names},
    })  # fmt: skip
    return tables.Policies(
        values["hash"], values["task"], values["rung"], values["level"], values["train_step"],
        values["mix_rate"], tuple(p.name for p in rows),
    )  # fmt: skip


def _tta(
    name: str, parts: Sequence[Dataset], header: FileHeader, rows: Sequence[Int64], goals: _Goals
) -> tuple[tables.TtaSet, Places]:
    rule, chosen = longest_sets(name, parts)
    found = in_order(chosen, [task.index for task in header.tasks])
    own = [part.tta.get(name) or _nothing(parts, name) for part in parts]
    ids = [np.flatnonzero(own[number].task == row) for number, row in found]
    places = Places(
        np.repeat([number for number, _ in found], [len(one) for one in ids]).astype(np.int64),
        np.concatenate([np.empty(0, np.int64), *ids]),
    )

    def column(name: str) -> NDArray[Any]:
        return places.column([getattr(table, name) for table in own])

    length = column("length")
    start = np.cumsum(length, dtype=np.int64) - length
    first = [
        float(own[number].preset_return[of[0]]) for (number, _), of in zip(found, ids, strict=True)
    ]
    task = places.column([of[t.task] for of, t in zip(rows, own, strict=True)])
    values = _columns(layout.TTA_EPISODES, {
        "task": task, "goal": goals.of(places, [table.goal for table in own]),
        "start": start, "obs_start": start + np.arange(len(places)), "length": length,
        "seed_key": column("seed_key"), "digest": column("digest"),
        "preset_return": np.repeat(first, [len(of) for of in ids]),
    })  # fmt: skip
    presets = {header.tasks[int(rows[number][row])].name: value
               for (number, row), value in zip(found, first, strict=True)}  # fmt: skip
    identity = header.content() | {"rule": _stored(rule), "preset_return": presets}
    steps = _steps(parts, places, own, own)
    arrays = {name: array for name, array in steps.items()
              if name in {f.name for f in fields(tables.TtaSet)}}  # fmt: skip
    hashed = content_hash(identity, values["digest"])
    return tables.TtaSet(
        name=name, rule=_stored(rule), content_hash=hashed, **arrays, **values
    ), places


def _nothing(parts: Sequence[Dataset], name: str) -> tables.TtaSet:
    """The set of a file that has none: that of another file without its episodes."""
    other = next(part.tta[name] for part in parts if name in part.tta)
    return replace(other, **{c.path: getattr(other, c.path)[:0] for c in layout.TTA_EPISODES})
