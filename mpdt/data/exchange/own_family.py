"""Foreign data as a family of its own: its definition is what the episodes show; no simulator.

    minari   every set below the folders          d4rl   every flat .hdf5
    npz      every .npz with the flat arrays of d4rl (observations, next_observations, actions,
             rewards, terminals, timeouts)

    walker/left-expert.npz      --task-from source   task left       quality expert
                                --task-from folder   task walker

A source's name without its version and the one word for a quality is its task. Sizes, bounds and
the longest episode are what the data have; references are means of its random and expert episodes,
of source `data`. Everything is read twice before anything is written.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.exchange import d4rl, flat_npz, foreign, hdf5, minari
from mpdt.data.exchange.claims import Said
from mpdt.data.exchange.folder import files_below, left_out
from mpdt.data.exchange.foreign import Source, quality_code, quality_name
from mpdt.data.exchange.incoming import Incoming
from mpdt.data.exchange.pickle_machine import kind_of
from mpdt.data.exchange.treatment import RawEpisode, Rules
from mpdt.data.reference import Reference, References
from mpdt.data.spec.family import Family, Role, Task
from mpdt.data.spec.rules import MOST_STEPS, family_name_problem, plain_problems
from mpdt.data.spec.tasks import FAMILIES
from mpdt.data.store.licence import UNKNOWN
from mpdt.errors import DataError, ShapeError, UsageError, quoted, unknown_name

TaskFrom = Literal["source", "folder"]
FORMATS = ("minari", "d4rl", "npz")
_VERSION = re.compile(r"[-_.]v\d+$")
_BREAKS = re.compile(r"[-_./]+")


@dataclass(frozen=True)
class Asked:
    """What a user says of such an import.

    Args:
        name: of the family.
        task: of all episodes; None = by `task_from`.
        test: tasks that are only tested on.
        horizon: steps; None = those of the longest episode.
    Raises: UsageError.
    """

    format: str
    name: str
    task_from: TaskFrom = "source"
    task: str | None = None
    quality: str | None = None
    test: tuple[str, ...] = ()
    horizon: int | None = None
    license: str = UNKNOWN

    def __post_init__(self) -> None:
        if self.format not in FORMATS:
            raise UsageError(f"{self.format} cannot become a family of its own",
                             where="--family-of", expected=", ".join(FORMATS),
                             hint="or name one with --family")  # fmt: skip
        if problem := family_name_problem(self.name):
            raise UsageError(problem, where="--family-of")
        if self.name in FAMILIES:
            raise UsageError("there is a family of that name",
                             where=f"--family-of {quoted(self.name)}",
                             hint="--family imports into it; or choose another name")  # fmt: skip
        if self.horizon is not None and self.horizon < 1:
            raise UsageError("too short", where="--horizon", expected="1 or more",
                             found=str(self.horizon))  # fmt: skip
        if self.quality is not None:
            quality_code(self.quality)


@dataclass(frozen=True)
class _Found:
    """One source before its numbers are believed; `read` may be called any number of times."""

    path: Path
    name: str
    folder: str
    read: Callable[[], Iterator[RawEpisode]]


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


def read(paths: Sequence[Path], asked: Asked, name: str) -> Incoming:
    """All sources below `paths` as one file of the family `asked.name`.

    Raises: UsageError, FormatError, DataError, ShapeError naming file and episode.
    """
    found, remarks = _SOURCES[asked.format](paths, asked)
    if not found:
        raise UsageError(
            f"nothing to import as {asked.format}", where=str(paths[0]) if paths else ""
        )
    spelled: dict[str, str] = {}
    labels = [_labels(one, asked, spelled) for one in found]
    seen, returns = _Seen(), dict[tuple[str, int], list[float]]()
    for one, label in zip(found, labels, strict=True):
        for number, raw in enumerate(one.read()):
            _look(raw, f"{one.path}: episode {number}", seen)
            total = float(np.asarray(raw.rewards, np.float64).sum())
            returns.setdefault(label, []).append(total)
    family = _family(asked, seen, returns)
    rules = Rules(
        format=asked.format, family=family, horizon=family.horizon, license=asked.license,
        any_length=set(seen.cut) != {family.horizon},
    )  # fmt: skip
    sources = [
        Source(one.path, family.task(task), quality, partial(_limited, one, rules), name=one.name)
        for one, (task, quality) in zip(found, labels, strict=True)
    ]
    remarks += [
        f"family {family.name}: {len(family.tasks)} tasks, {seen.observations} columns, "
        f"{seen.actions} actions up to {family.action_high:g}, {family.horizon} steps; nobody "
        "simulates it: no replay, no new sets, no returns of a policy"
    ]
    incoming = foreign.incoming(sources, rules, name, remarks)
    tasks = [
        replace(row, references=_references(row.name, returns)) for row in incoming.header.tasks
    ]
    return replace(incoming, header=replace(incoming.header, tasks=tasks))


def _labels(one: _Found, asked: Asked, spelled: dict[str, str]) -> tuple[str, int]:
    """Task and quality code of a source.

    Args:
        spelled: tasks of the sources before, as they were spelled; added to.
    Raises: UsageError for a name that names no task, or would be the name of two.
    """
    plain = _VERSION.sub("", one.name)
    words = [word for word in _BREAKS.split(plain) if word]
    told = [word for word in words if word in QUALITY_CODES]
    quality = asked.quality or (told[0] if len(told) == 1 else "unknown")
    task = own = asked.task
    if task is None and asked.task_from == "folder":
        task = own = one.folder
    elif task is None:
        task = "-".join(word for word in words if len(told) != 1 or word not in told)
        # a_b and a-b are two tasks, a_b-expert and a_b.random are one.
        own = _without(plain, told[0]) if len(told) == 1 else plain
    if not task:
        raise UsageError("its name names no task", where=str(one.path),
                         hint="--task NAME, or --task-from folder")  # fmt: skip
    name = re.sub(r"[^A-Za-z0-9_.-]", "_", task)
    if spelled.setdefault(name, str(own)) != own:
        raise UsageError(f"two tasks would be named '{name}'", where=str(one.path),
                         expected="names that differ in letters, digits, . _ -",
                         found=f"'{spelled[name]}' and '{own}'",
                         hint="rename one of them")  # fmt: skip
    return name, quality_code(quality)


def _without(name: str, word: str) -> str:
    """A name as it is written, without one of its words and the break before it."""
    return re.sub(rf"(^|[-_./]+){word}(?![^-_./])", "", name).strip("-_./")


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


def _limited(one: _Found, rules: Rules) -> Iterator[RawEpisode]:
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
        columns=tuple(f"o{i:0{digits}} [1]" for i in range(seen.observations)),
        action_size=seen.actions, action_low=-bound, action_high=bound,
        horizon=asked.horizon or seen.longest, step_s=1.0,
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


# ---- sources ----


def _minari(paths: Sequence[Path], asked: Asked) -> tuple[list[_Found], list[str]]:
    known = files_below(paths, ".json")
    folders = [path.parent for path in known if path.name == "metadata.json"]
    draft = Rules(asked.format, _draft(asked), asked.horizon or MOST_STEPS, quality="unknown")
    found = []
    for folder in folders:
        metadata = minari.read_metadata(folder)
        id = str(metadata.get("dataset_id", "")) or folder.parent.name
        read = partial(minari.foreign_episodes, folder, metadata, Said(), draft)
        found.append(_Found(folder / minari.MAIN, id, id.split("/")[-2] if "/" in id else "", read))
    return found, []


def _flat(paths: Sequence[Path], asked: Asked) -> tuple[list[_Found], list[str]]:
    files = files_below(paths, ".hdf5", ".h5")
    found = []
    for path in files:
        with hdf5.opened(path) as file:
            if "timeouts" not in file and asked.horizon is None:
                raise flat_npz.no_limit(path)
            bounds = d4rl.episode_bounds(file, asked.horizon or MOST_STEPS, str(path))
        read = partial(d4rl.foreign_episodes, path, bounds)
        found.append(_Found(path, path.stem, path.absolute().parent.name, read))
    return found, left_out(paths, files)


def _npz(paths: Sequence[Path], asked: Asked) -> tuple[list[_Found], list[str]]:
    files = files_below(paths, ".npz")
    found = [
        _Found(
            path,
            path.stem,
            path.absolute().parent.name,
            partial(flat_npz.episodes, path, asked.horizon),
        )
        for path in files
    ]
    return found, left_out(paths, files)


_SOURCES = {"minari": _minari, "d4rl": _flat, "npz": _npz}


def _draft(asked: Asked) -> Family:
    """Of any sizes, for readers that ask for a family before one is known."""
    return Family(name=asked.name, tasks=(Task("all", 0, "train"),), columns=("o [1]",),
                  action_size=1, horizon=MOST_STEPS, step_s=1.0, return_target=0.0,
                  return_scale=1.0)  # fmt: skip
