"""Facts: what a data card says of a file, as numbers and words; figures.py draws them."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.reference import References, level
from mpdt.data.spec.family import Family
from mpdt.data.store import layout
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.tables import Float64, Int64
from mpdt.errors import DataError, MpdtError

QUALITIES = {**QUALITY_CODES, "unknown": -1}
ROLES = {code: role for role, code in layout.ROLE_CODES.items()}


@dataclass(frozen=True, eq=False)
class Group:
    """The chosen episodes of one task and quality, at least one.

    Args:
        ids: absolute episode ids.
        returns, lengths, progress: (n,) of these episodes.
        success: share with a successful step; None where the simulator has none.
    """

    quality: str
    ids: Int64
    returns: Float64
    lengths: Int64
    progress: Float64
    success: float | None

    @property
    def mean(self) -> float:
        return float(self.returns.mean())

    @property
    def error(self) -> float:
        """Standard error of the mean; nan of a single episode."""
        if len(self.ids) < 2:
            return math.nan
        return float(self.returns.std(ddof=1)) / math.sqrt(len(self.ids))

    def typical(self) -> int:
        """Id of the episode whose return is the median (of an even number the lower one)."""
        return int(self.ids[np.argsort(self.returns, kind="stable")[(len(self.ids) - 1) // 2]])


@dataclass(frozen=True, eq=False)
class TaskFacts:
    """One task that has chosen episodes."""

    row: int
    name: str
    role: str
    references: References
    groups: Mapping[str, Group]
    """By quality, in the order random, medium, expert, history, policy, unknown."""

    @property
    def episodes(self) -> int:
        return sum(len(group.ids) for group in self.groups.values())

    def level(self, value: float) -> float:
        """Of a return, between the references; nan where one is unknown."""
        return level(value, self.references["random"].mean, self.references["expert"].mean)


@dataclass(frozen=True, eq=False)
class Facts:
    """A file, or one slice of it."""

    data: Dataset
    slice: str | None
    ids: Int64
    tasks: tuple[TaskFacts, ...]

    @cached_property
    def family(self) -> Family | None:
        """Where mpdt or the file knows it."""
        try:
            return self.data.contract()
        except MpdtError:
            return None

    @classmethod
    def of(cls, data: Dataset, slice: str | None = None) -> Facts:
        """Raises: UsageError for an unknown slice; DataError for one without episodes."""
        ids = data.select(slice=slice)
        if not len(ids):
            raise DataError("no episodes", where=f"{data.path}{f':{slice}' if slice else ''}")
        rows = np.unique(data.episodes.task[ids]).tolist()
        return cls(data, slice, ids, tuple(_task(data, ids, int(row)) for row in rows))

    @cached_property
    def qualities(self) -> list[str]:
        """Those present, in their order."""
        present = {quality for task in self.tasks for quality in task.groups}
        return [quality for quality in QUALITIES if quality in present]

    @cached_property
    def lengths(self) -> dict[str, Int64]:
        """Lengths of the episodes of each quality present, all tasks together."""
        return {
            quality: np.concatenate(
                [task.groups[quality].lengths for task in self.tasks if quality in task.groups]
            )
            for quality in self.qualities
        }

    @property
    def num_steps(self) -> int:
        return int(self.data.episodes.length[self.ids].sum())


def _task(data: Dataset, ids: Int64, row: int) -> TaskFacts:
    columns, mine = data.episodes, ids[data.episodes.task[ids] == row]
    groups = {}
    for quality, code in QUALITIES.items():
        of = mine[columns.quality[mine] == code]
        if len(of):
            has_success = data.steps.successes is not None
            groups[quality] = Group(
                quality, of, columns.returns[of], columns.length[of].astype(np.int64),
                columns.progress[of].astype(np.float64),
                float(columns.success[of].mean()) if has_success else None,
            )  # fmt: skip
    return TaskFacts(row, data.tasks.names[row], ROLES[int(data.tasks.roles[row])],
                     data.tasks.references[row], groups)  # fmt: skip


def commands(data: Dataset, slice: str | None, is_locked: bool) -> list[str]:
    """What to type for the same episodes again, oldest step first.

    Steps that no command alone repeats (merging files that are not here, an import) are comments.
    Every name is quoted: the lines are meant to be pasted, and the names come out of the file.
    """
    name = data.name
    is_smoke = name.endswith("-smoke")
    made = ["mpdt-data", "collect", name.removesuffix("-smoke")]
    made += ["--smoke"] * is_smoke + ["--locked"] * is_locked
    origin = data.spec.get("import")
    found = [shlex.join(made) if origin is None else _comment(f"imported: {_words(origin)}")]
    source = f"{name}.h5"
    for place, step in enumerate(data.lineage):
        target = data.title if place == len(data.lineage) - 1 else f"{name}-{place + 1}.h5"
        found.append(_repeated(step, source, target))
        source = target
    if slice is not None:
        found.append(_comment(f"slice {slice}: {_words(data.slice_rules.get(slice, {}))}"))
        found.append(shlex.join(["mpdt-data", "show", f"{source}:{slice}"]))
    return found


def _repeated(step: Mapping[str, Any], source: str, target: str) -> str:
    """One step of the lineage as a command, or told of where it is none."""
    rule = step.get("rule") or {}
    if step.get("verb") == "split":
        with suppress(TypeError, ValueError, AttributeError):  # a rule that no split wrote
            return shlex.join(["mpdt-data", "split", *_split_words(rule, source), "-o", target])
    origins = " and ".join(str(origin)[:8] for origin in step.get("from", ()))
    return _comment(f"{step.get('verb', '?')} {_words(rule)} of {origins} -> {target}")


def _split_words(rule: Mapping[str, Any], source: str) -> list[str]:
    words = [f"{source}:{rule['slice']}" if "slice" in rule else source]
    for key, value in rule.items():
        option = f"--{key.replace('_', '-')}"
        if key == "role":
            words.append(f"--{value}")
        elif key == "progress":
            words += [option, ":".join(f"{end:g}" for end in value)]
        elif key == "tasks":
            words += [option, ",".join(map(str, value))]
        elif key != "slice":
            words += [option, str(value)]
    return words


def _comment(text: str) -> str:
    """On one line, whatever the text holds."""
    return "# " + " ".join(text.split())


def _words(rule: Any) -> str:
    """`quality medium, episodes 10`."""
    if not isinstance(rule, Mapping):
        return str(rule)
    parts = []
    for key, value in rule.items():
        text = " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
        parts.append(f"{key} {text if len(text) <= 60 else text[:57] + '...'}")
    return ", ".join(parts)
