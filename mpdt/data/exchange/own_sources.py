"""Where the episodes of a family of its own lie, and what each source is called.

    walker/left-expert.npz      --task-from source   task left       quality expert
                                --task-from folder   task walker
    reach-expert/ (LeRobot)     --task-from source   the text of its task_index
                                --task-from goal     what the column goal holds, once per episode

A source's name without its version and the one word for a quality is its task; a LeRobot tree has
texts for that, and its folder's name may have the word.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.exchange import d4rl, flat_npz, hdf5, lerobot_rows, lerobot_tree, minari_in
from mpdt.data.exchange.claims import Said
from mpdt.data.exchange.folder import files_below, left_out
from mpdt.data.exchange.foreign import quality_code
from mpdt.data.exchange.minari_claims import environment_in
from mpdt.data.exchange.minari_sets import main_file, notes_of
from mpdt.data.exchange.treatment import RawEpisode, Rules
from mpdt.data.spec.family import Family, Task
from mpdt.data.spec.rules import COLUMN, MOST_STEPS, family_name_problem
from mpdt.data.spec.tasks import FAMILIES
from mpdt.data.store.licence import UNKNOWN
from mpdt.errors import FormatError, UsageError, quoted, unknown_name

FORMATS = ("minari", "d4rl", "npz", "lerobot")
TASKS_FROM = ("source", "folder")
_VERSION = re.compile(r"[-_.]v\d+$")
_BREAKS = re.compile(r"[-_./]+")
_FAMILY = re.compile(r"[A-Za-z0-9_.-]+: +")
_LONGEST = 100
"""Letters of a task's name; a longer text is cut, and ends with eight that tell it apart."""


@dataclass(frozen=True)
class Asked:
    """What a user says of such an import.

    Args:
        name: of the family.
        task_from: `source`, `folder`, or of a LeRobot tree a column.
        task: of all episodes; None = by `task_from`.
        test: tasks that are only tested on.
        horizon: steps; None = those of the longest episode.
        states: columns of a LeRobot tree that are the observation, side by side.
        env: simulate by the environment that Minari sets record.
    Raises: UsageError.
    """

    format: str
    name: str
    task_from: str = "source"
    task: str | None = None
    quality: str | None = None
    test: tuple[str, ...] = ()
    horizon: int | None = None
    license: str = UNKNOWN
    states: tuple[str, ...] = ()
    env: bool = False

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
        if self.env and self.format != "minari":
            raise UsageError(f"{self.format} names no environment", where="--env",
                             expected="Minari sets", hint="leave it out")  # fmt: skip
        if self.format != "lerobot":
            if self.task_from not in TASKS_FROM:
                raise UsageError(f"{self.format} has no columns that name tasks",
                                 where="--task-from", expected=" or ".join(TASKS_FROM),
                                 found=self.task_from)  # fmt: skip
            if self.states:
                raise UsageError(f"{self.format} has one observation", where="--states",
                                 hint="leave it out")  # fmt: skip


@dataclass(frozen=True)
class Found:
    """One source before its numbers are believed.

    Args:
        read: its episodes; called any number of times.
        task: as the source itself says it, in any letters; "" = by its name.
        columns: names of the observation's numbers, where the source has them.
        step_s: seconds per step; 0 = not said.
        notes: what the spec of the new file should say of it.
        environment: as `environment_in` gives it, where it was asked for.
    """

    path: Path
    name: str
    folder: str
    read: Callable[[], Iterator[RawEpisode]]
    task: str = ""
    columns: tuple[str, ...] = ()
    step_s: float = 0.0
    notes: Mapping[str, Any] = field(default_factory=dict)
    environment: Mapping[str, Any] = field(default_factory=dict)


def find(paths: Sequence[Path], asked: Asked) -> tuple[list[Found], list[str]]:
    """The sources below `paths`, and what a user should know of them.

    Raises: UsageError, FormatError, DataError naming file.
    """
    found, remarks = _SOURCES[asked.format](paths, asked)
    if not found:
        raise UsageError(
            f"nothing to import as {asked.format}", where=str(paths[0]) if paths else ""
        )
    return found, remarks


def labels(one: Found, asked: Asked, spelled: dict[str, str]) -> tuple[str, int]:
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
    elif task is None and one.task:
        task, own = _of_text(one.task), one.task
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


def _of_text(text: str) -> str:
    """`Pick up the cube, then wait.` as `Pick_up_the_cube_then_wait`."""
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", text).strip("_.-")
    if len(name) <= _LONGEST:
        return name
    return f"{name[: _LONGEST - 9]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def _minari(paths: Sequence[Path], asked: Asked) -> tuple[list[Found], list[str]]:
    draft = Rules(asked.format, _draft(asked), asked.horizon or MOST_STEPS, quality="unknown")
    found = []
    for folder, metadata in minari_in.sets_below(paths).items():
        id = str(metadata.get("dataset_id", "")) or folder.parent.name
        read = partial(minari_in.foreign_episodes, folder, metadata, Said(), draft)
        world = environment_in(metadata, str(folder)) if asked.env else {}
        group = id.split("/")[-2] if "/" in id else ""
        found.append(Found(main_file(folder, metadata), id, group, read,
                           notes=notes_of(folder, metadata), environment=world))  # fmt: skip
    return found, []


def _flat(paths: Sequence[Path], asked: Asked) -> tuple[list[Found], list[str]]:
    files = files_below(paths, ".hdf5", ".h5")
    found = []
    for path in files:
        with hdf5.opened(path) as file:
            if "timeouts" not in file and asked.horizon is None:
                raise flat_npz.no_limit(path)
            bounds = d4rl.episode_bounds(file, asked.horizon or MOST_STEPS, str(path))
        read = partial(d4rl.foreign_episodes, path, bounds)
        found.append(Found(path, path.stem, path.absolute().parent.name, read))
    return found, left_out(paths, files)


def _npz(paths: Sequence[Path], asked: Asked) -> tuple[list[Found], list[str]]:
    files = files_below(paths, ".npz")
    found = [
        Found(
            path,
            path.stem,
            path.absolute().parent.name,
            partial(flat_npz.episodes, path, asked.horizon),
        )
        for path in files
    ]
    return found, left_out(paths, files)


def _lerobot(paths: Sequence[Path], asked: Asked) -> tuple[list[Found], list[str]]:
    found, remarks = list[Found](), list[str]()
    for tree in lerobot_tree.trees(paths):
        states = asked.states or lerobot_tree.STATES[:1]
        by = lerobot_rows.TASK if asked.task_from in TASKS_FROM else asked.task_from
        _check_columns(tree, states, by)
        wanted = lerobot_tree.wanted_of(tree, states, by)
        columns, folder = _named_columns(tree, states), tree.folder.absolute().name
        before = _common_family(tree)
        for path, label in lerobot_tree.by_task(tree, wanted):
            task = "" if asked.task is not None else _said(tree, label, by, before)
            read = partial(lerobot_tree.episodes, path, wanted, label)
            step_s = 1 / tree.fps if tree.fps else 0.0
            notes = {"states": list(states), "tasks_from": by}
            found.append(Found(path, folder, folder, read, task, columns, step_s, notes))
        remarks += lerobot_tree.left_out(tree, wanted)
    return found, remarks


def _check_columns(tree: lerobot_tree.Tree, states: Sequence[str], by: str) -> None:
    """Raises: FormatError for a tree without actions or rewards; UsageError for wrong names."""
    where, there = str(tree.folder), [*tree.widths]
    if lerobot_rows.ACTION not in tree.widths:
        raise FormatError("no action in it", where=where, expected="actions as numbers",
                          found=", ".join(there)[:160])  # fmt: skip
    if tree.widths.get(lerobot_rows.REWARD) != 1:
        raise FormatError("no next.reward in it", where=where,
                          expected="the reward of each step, one number",
                          found=", ".join(there)[:160],
                          hint="policies here are asked for a return: add the column to the tree, "
                          "such as 1 where a step succeeds and 0 elsewhere")  # fmt: skip
    numbers = [name for name in there if name.startswith("observation.")]
    for name in states:
        if name not in numbers:
            raise unknown_name("column", name, numbers, where=f"{where}: --states")
    if len(set(states)) != len(states):
        raise UsageError("a column twice", where=f"{where}: --states", found=",".join(states))
    if by != lerobot_rows.TASK and tree.widths.get(by) != 1:
        singles = [name for name, width in tree.widths.items() if width == 1]
        raise unknown_name("column of one value", by, [*TASKS_FROM, *singles],
                           where=f"{where}: --task-from")  # fmt: skip


def _named_columns(tree: lerobot_tree.Tree, states: Sequence[str]) -> tuple[str, ...]:
    """`name [unit]` of each number, where the tree names all of them."""
    words = [word for name in states for word in tree.names.get(name, ())]
    if len(words) != sum(tree.widths[name] for name in states) or len(set(words)) != len(words):
        return ()
    units = [word if word.endswith("]") else f"{word} [1]" for word in words]
    return tuple(units) if all(COLUMN.fullmatch(word) for word in units) else ()


def _common_family(tree: lerobot_tree.Tree) -> str:
    """`cheetah_dir: ` where every text begins so, as in our own trees."""
    found = _FAMILY.match(next(iter(tree.texts.values()), ""))
    before = found.group() if found else ""
    return before if all(text.startswith(before) for text in tree.texts.values()) else ""


def _spelled(number: float) -> str:
    """As short as names this number and no other: 0.1 of a float32 column is 0.1."""
    if isinstance(number, int) or number.is_integer():
        return str(int(number))
    single = np.float32(number)
    return str(single) if float(single) == number else repr(number)


def _said(tree: lerobot_tree.Tree, label: lerobot_rows.Label, by: str, before: str) -> str:
    """What names a task: the text of its number, or what stands in a column."""
    if by == lerobot_rows.TASK:
        return tree.text_of(label).removeprefix(before)
    return label if isinstance(label, str) else f"{by.rpartition('.')[2]}_{_spelled(label)}"


_SOURCES = {"minari": _minari, "d4rl": _flat, "npz": _npz, "lerobot": _lerobot}


def _draft(asked: Asked) -> Family:
    """Of any sizes, for readers that ask for a family before one is known."""
    return Family(name=asked.name, tasks=(Task("all", 0, "train"),), columns=("o [1]",),
                  action_size=1, horizon=MOST_STEPS, step_s=1.0, return_target=0.0,
                  return_scale=1.0)  # fmt: skip
