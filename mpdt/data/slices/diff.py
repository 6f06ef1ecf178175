"""Diff: in what two files differ: header, tasks, episodes, fields, slices, TTA sets.

Episodes are compared by digest; those at one place (task, quality, block, row) with other bytes
are `changed`, and the first of them are looked into, array by array.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.spec.change import changed_keys
from mpdt.data.store.dataset import Dataset
from mpdt.seeding import UNKNOWN_SEED_KEY

Container = Mapping[str, Any]
SHOWN = 3
_FIELDS = (
    "observations", "actions", "rewards", "terminations", "truncations", "successes", "goal",
    "progress", "policy",
)  # fmt: skip


@dataclass(frozen=True)
class RunDiff:
    """One quality of one task. `changed` are (id in A, id in B, names of the differing fields)."""

    task: str
    quality: str
    same: int
    only_a: int
    only_b: int
    changed: int
    examples: tuple[tuple[int, int, tuple[str, ...]], ...] = ()


@dataclass(frozen=True)
class Diff:
    """What differs; everything is empty for equal files.

    `header` has lines `key old -> new`; `runs` only those that differ.
    """

    header: list[str]
    tasks_only_a: list[str]
    tasks_only_b: list[str]
    runs: list[RunDiff]
    slices: list[str]
    tta: list[str]
    same_content: bool

    @property
    def is_empty(self) -> bool:
        parts = (
            self.header,
            self.tasks_only_a,
            self.tasks_only_b,
            self.runs,
            self.slices,
            self.tta,
        )
        return self.same_content and not any(parts)


def diff(a: Dataset, b: Dataset) -> Diff:
    """Compare two files; episodes are looked into only where their digests differ."""
    names = [*a.tasks.names, *(n for n in b.tasks.names if n not in a.tasks.names)]
    runs = []
    for name in names:
        for quality in (*QUALITY_CODES, "unknown"):
            run = _run(a, b, name, quality)
            if run.only_a or run.only_b or run.changed:
                runs.append(run)
    return Diff(
        header=changed_keys(_header(a), _header(b)),
        tasks_only_a=[n for n in a.tasks.names if n not in b.tasks.names],
        tasks_only_b=[n for n in b.tasks.names if n not in a.tasks.names],
        runs=runs,
        slices=_slices(a, b),
        tta=_tta(a, b),
        same_content=a.content_hash == b.content_hash,
    )


def _header(data: Dataset) -> dict[str, Any]:
    return {
        "family": data.family, "name": data.name, "version": data.version,
        "license": data.license, "parent": data.parent, "spec": dict(data.spec),
        "packages": dict(data.packages), "platform": dict(data.platform),
        "fields": data.content_header()["fields"],
        "observation_size": data.observation_size, "action_size": data.action_size,
        "references": {
            task: {
                name: round(data.tasks.references[row][name].mean, 6)
                for name in sorted(data.tasks.references[row].by_name)
            }
            for row, task in enumerate(data.tasks.names)
        },
    }  # fmt: skip


def _run(a: Dataset, b: Dataset, task: str, quality: str) -> RunDiff:
    left, right = _digests(a, task, quality), _digests(b, task, quality)
    # By digest first: imported episodes have no place, and stand in any order.
    common = set(left) & set(right)
    rest_a, rest_b = ({d: i for d, i in side.items() if d not in common} for side in (left, right))
    places = {_place(a, i): i for i in rest_a.values()}
    pairs = []
    for i in rest_b.values():
        place = _place(b, i)
        if place in places and place != UNKNOWN_SEED_KEY[3:]:
            pairs.append((places[place], i))
    examples = tuple((i, j, _fields(a, i, b, j)) for i, j in pairs[:SHOWN])
    return RunDiff(task, quality, len(common), len(rest_a) - len(pairs),
                   len(rest_b) - len(pairs), len(pairs), examples)  # fmt: skip


def _digests(data: Dataset, task: str, quality: str) -> dict[bytes, int]:
    if task not in data.tasks.names:
        return {}
    ids = data.select(task=task, quality=quality).tolist()
    return {data.episodes.digest[i].tobytes(): i for i in ids}


def _place(data: Dataset, i: int) -> tuple[int, int]:
    key = data.episodes.seed_key[i]
    return int(key[3]), int(key[4])


def _fields(a: Dataset, i: int, b: Dataset, j: int) -> tuple[str, ...]:
    """Which fields of two episodes differ."""
    one, two = a.episode(i), b.episode(j)
    pairs = ((name, getattr(one, name), getattr(two, name)) for name in _FIELDS)
    return tuple(name for name, x, y in pairs if _bytes(x) != _bytes(y))


def _bytes(value: Any) -> Any:
    return (value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value


def _slices(a: Dataset, b: Dataset) -> list[str]:
    """One line per slice that is not the same list of episodes."""
    return _named("slice", a.slices, b.slices,
                  lambda n: np.array_equal(a.slices[n], b.slices[n])
                  or _ids_as_digests(a, n) == _ids_as_digests(b, n))  # fmt: skip


def _ids_as_digests(data: Dataset, name: str) -> bytes:
    return data.episodes.digest[data.slices[name]].tobytes()


def _tta(a: Dataset, b: Dataset) -> list[str]:
    return _named("tta set", a.tta, b.tta,
                  lambda n: a.tta[n].content_hash == b.tta[n].content_hash)  # fmt: skip


def _named(kind: str, a: Container, b: Container, same: Callable[[str], bool]) -> list[str]:
    lines = [f"{kind} {name}: only in A" for name in a if name not in b]
    lines += [f"{kind} {name}: only in B" for name in b if name not in a]
    return lines + [f"{kind} {name}: differs" for name in a if name in b and not same(name)]
