"""Foreign data as a family of its own: its definition is what the episodes show; no simulator.

    minari    every set below the folders          d4rl   every flat .hdf5
    lerobot   every tree                           npz    every .npz with the flat arrays of d4rl

Sizes, bounds and the longest episode are what the data have; references are means of its random and
expert episodes, of source `data`. Where it was asked for, the environment that Minari sets record
simulates it (`own_world.py`). Everything is read twice before anything is written.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mpdt.data.exchange import foreign
from mpdt.data.exchange.foreign import Source, quality_name
from mpdt.data.exchange.incoming import Incoming
from mpdt.data.exchange.own_sources import Asked, Found, find, labels
from mpdt.data.exchange.own_world import with_world, world_of
from mpdt.data.exchange.pickle_machine import kind_of
from mpdt.data.exchange.treatment import RawEpisode, Rules
from mpdt.data.reference import Reference, References
from mpdt.data.spec.family import Family, Role, Task
from mpdt.data.spec.rules import plain_problems
from mpdt.errors import DataError, ShapeError, UsageError, unknown_name


@dataclass
class _Seen:
    """What the first reading saw of all sources."""

    observations: int = 0
    actions: int = 0
    longest: int = 0
    largest: float = 0.0
    ends: bool = False
    success: bool = False
    cut: tuple[int, ...] = ()
    columns: tuple[str, ...] = ()
    step_s: float = 0.0


def read(paths: Sequence[Path], asked: Asked, name: str) -> Incoming:
    """All sources below `paths` as one file of the family `asked.name`.

    Raises: UsageError, FormatError, DataError, ShapeError naming file and episode.
    """
    found, remarks = find(paths, asked)
    spelled: dict[str, str] = {}
    told = [labels(one, asked, spelled) for one in found]
    seen, returns = _common(found), dict[tuple[str, int], list[float]]()
    for one, label in zip(found, told, strict=True):
        for number, raw in enumerate(one.read()):
            _look(raw, f"{one.path}: episode {number}", seen)
            total = float(np.asarray(raw.rewards, np.float64).sum())
            returns.setdefault(label, []).append(total)
    family = _family(asked, seen, returns)
    if asked.env:
        world = world_of(found, [task for task, _ in told], seen.longest)
        family = with_world(family, world, asked.horizon)
    rules = Rules(
        format=asked.format, family=family, horizon=family.horizon, license=asked.license,
        any_length=set(seen.cut) != {family.horizon}, with_seeds=asked.env,
    )  # fmt: skip
    sources = [
        Source(
            one.path,
            family.task(task),
            quality,
            partial(_limited, one, rules),
            name=one.name,
            notes=one.notes,
        )
        for one, (task, quality) in zip(found, told, strict=True)
    ]
    simulated = (
        f"; {family.about}, which simulates it" if asked.env else
        "; nobody simulates it: no replay, no new sets, no returns of a policy"
    )  # fmt: skip
    remarks += [
        f"family {family.name}: {len(family.tasks)} tasks, {seen.observations} columns, "
        f"{seen.actions} actions up to {family.action_high:g}, {family.horizon} steps{simulated}"
    ]
    incoming = foreign.incoming(sources, rules, name, remarks)
    tasks = [
        replace(row, references=_references(row.name, returns)) for row in incoming.header.tasks
    ]
    return replace(incoming, header=replace(incoming.header, tasks=tasks))


def _common(found: Sequence[Found]) -> _Seen:
    """What all sources say, before anything is looked at; nothing of what they do not agree in."""
    columns, steps = {one.columns for one in found}, {one.step_s for one in found}
    return _Seen(columns=columns.pop() if len(columns) == 1 else (),
                 step_s=steps.pop() if len(steps) == 1 else 0.0)  # fmt: skip


def _look(raw: RawEpisode, where: str, seen: _Seen) -> None:
    """Raises: ShapeError for what is no episode, or one of another size than those before."""
    for key, array in (("observations", raw.observations), ("actions", raw.actions)):
        if not _is_matrix(array):
            raise ShapeError(f"wrong {key}", where=where, expected="a matrix of floats",
                             found=kind_of(array))  # fmt: skip
        known, width = getattr(seen, key), array.shape[1]
        if known and known != width:
            raise ShapeError(f"{key} of another size than in the episodes before", where=where,
                             expected=str(known), found=str(width))  # fmt: skip
        setattr(seen, key, width)
    rewards = np.asarray(raw.rewards)
    if rewards.dtype.kind not in "biuf":
        raise ShapeError("wrong rewards", where=where, expected="numbers", found=kind_of(rewards))
    length = len(raw.actions)
    seen.longest = max(seen.longest, length)
    seen.largest = max(seen.largest, float(np.abs(raw.actions, dtype=np.float64).max()))
    seen.success |= raw.successes is not None
    ended = raw.terminations is not None and bool(np.any(raw.terminations))
    seen.ends |= ended or raw.ends is not None
    if not ended:
        seen.cut = tuple({*seen.cut, length})


def _limited(one: Found, rules: Rules) -> Iterator[RawEpisode]:
    """Its episodes; one that ends by its own rule at the time limit is cut off there as well."""
    for raw in one.read():
        at_limit = len(raw.actions) == rules.horizon and not rules.any_length
        if at_limit and raw.truncations is not None:
            cut = np.array(raw.truncations).reshape(-1)
            cut[-1:] = True
            raw = replace(raw, truncations=cut)
        yield raw


def _is_matrix(array: Any) -> bool:
    is_array = isinstance(array, np.ndarray)
    return bool(is_array and array.ndim == 2 and array.size and array.dtype.kind == "f")


def _family(asked: Asked, seen: _Seen, returns: Mapping[tuple[str, int], list[float]]) -> Family:
    """Raises: UsageError for tests that are no tasks; DataError for data that make no family."""
    names = sorted({task for task, _ in returns}, key=foreign.natural)
    for test in asked.test:
        if test not in names:
            raise unknown_name("task", test, names, where="--test")
    # Of training tasks alone: nothing of a test task may decide what is asked for.
    known = [total for (task, _), totals in returns.items() if task not in asked.test
             for total in totals]  # fmt: skip
    if not known:
        raise UsageError("no training task is left", where="--test", hint="name fewer")
    target = max(known)
    roles: dict[bool, Role] = {True: "test", False: "train"}
    digits = len(str(seen.observations - 1))
    bound = 1.0 if seen.largest <= 1.0 else seen.largest
    family = Family(
        name=asked.name,
        tasks=tuple(Task(name, i, roles[name in asked.test]) for i, name in enumerate(names)),
        columns=seen.columns if len(seen.columns) == seen.observations else
        tuple(f"o{i:0{digits}} [1]" for i in range(seen.observations)),
        action_size=seen.actions, action_low=-bound, action_high=bound,
        horizon=asked.horizon or seen.longest, step_s=seen.step_s or 1.0,
        return_target=target, return_scale=max(abs(target), target - min(known)) or 1.0,
        goal_hidden=False, has_success=seen.success, ends_early=seen.ends, exact=False,
        about=f"Imported from {asked.format}: no simulator",
    )  # fmt: skip
    if problems := plain_problems(family):
        raise DataError("the data make no family", where=asked.name, found=problems[0][:160],
                        hint="--task names all of it, --task-from folder its folders")  # fmt: skip
    return family


def _references(task: str, returns: Mapping[tuple[str, int], list[float]]) -> References:
    by_name = {
        quality_name(code): Reference.of(np.array(totals), source="data")
        for (name, code), totals in returns.items()
        if name == task and quality_name(code) in ("random", "expert")
    }
    return References(by_name)
