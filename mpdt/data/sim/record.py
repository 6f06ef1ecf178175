"""The record of references: what the reference policies return per task, as data with its evidence.

Shipped in `weights/references.json`, one line per scene, horizon and simulator options.
`measure.py` measures, into LOCAL_FILE of the working folder; what is there wins.

    scene    cheetah/velocity/0.225   sawyer/metaworld/reach     no family: what ml10 and mt50
                                                                  have in common is measured once
    policy   zero   random   constant+0 .. constant-5   expert:<hash of the policy>

An expert counts only for the very policy that was measured: its hash covers weights and noise,
or the script. With others, `collect` measures by itself (`spec.reference` episodes).
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

import msgspec

from mpdt.data.reference import Reference, Source
from mpdt.data.sim.book import read_book, write_book
from mpdt.data.sim.ladder import Ladder
from mpdt.data.spec.entry import DatasetSpec, canonical_json
from mpdt.data.spec.tasks import Task, get_family
from mpdt.disk import check_replaceable

FORMAT = "mpdt-references/1"
LOCAL_FILE = "references.json"

Place = tuple[str, int, str]
"""What an entry is for: scene, horizon, canonical JSON of the simulator options."""


class Score(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Mean and standard deviation (ddof 1) of the returns of some episodes of one policy.

    `success` is the share of successful episodes, None where the simulator has none.
    """

    episodes: int
    mean: float
    std: float
    success: float | None = None

    @property
    def error(self) -> float:
        """Standard error of the mean."""
        return self.std / math.sqrt(self.episodes)

    def joined(self, other: Score) -> Score:
        """Of both sets of episodes. Source: Chan, Golub, LeVeque 1983, equation 1.5."""
        n, m = self.episodes, other.episodes
        gap = other.mean - self.mean
        squares = (n - 1) * self.std**2 + (m - 1) * other.std**2 + gap**2 * n * m / (n + m)
        success = self.success
        if success is not None and other.success is not None:
            success = round((n * success + m * other.success) / (n + m), 9)
        mean, std = self.mean + gap * m / (n + m), math.sqrt(squares / (n + m - 1))
        return Score(n + m, round(mean, 6), round(std, 6), success)

    def reference(self, source: Source) -> Reference:
        return Reference(self.mean, self.error, self.episodes, self.success, source)


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What is known of one scene at one horizon.

    Args:
        scores: by policy; see the top of the file.
        seed: root seed; episode n of a policy has block 0, row n of its REFERENCE quality, in
            family mt50 for Meta-World and in the scene's own family otherwise.
        versions: packages the numbers were measured with.
    """

    scene: str
    horizon: int
    env: dict[str, float | bool]
    scores: dict[str, Score]
    seed: int
    versions: dict[str, str]

    @property
    def place(self) -> Place:
        return (self.scene, self.horizon, canonical_json(self.env).decode())


@dataclass(frozen=True)
class Record:
    """What is on record of one task of a spec.

    Args:
        by_name: zero, random and expert, as far as they are known.
        constants: every candidate of `constants.constant_actions`, in its order; empty unless
            all of them are known.
    """

    by_name: Mapping[str, Reference] = field(default_factory=dict)
    constants: tuple[Reference, ...] = ()


NOTHING = Record()


def place_of(spec: DatasetSpec, task: Task, horizon: int) -> Place:
    """Where a task of a spec stands in the record, at any horizon."""
    env = canonical_json(spec.env).decode()
    return (get_family(spec.family).scene_of(task), horizon, env)


def constant_names(action_size: int) -> list[str]:
    """Names of the candidates of `constants.constant_actions`, in its order."""
    axes = range(action_size)
    return ["zero", *(f"constant+{axis}" for axis in axes), *(f"constant-{axis}" for axis in axes)]


def expert_name(ladder: Ladder, task: Task) -> str:
    """Name of a task's expert in a record: changes with its weights, noise or script."""
    return f"expert:{ladder.policy(task, 'expert', 0)[0].info.hash.hex()}"


def find_records(
    spec: DatasetSpec, ladder: Ladder, folder: Path | None = None
) -> dict[str, Record]:
    """By task name, what is on record: shipped, or in `folder`/LOCAL_FILE (default: here).

    Args:
        ladder: of the spec; its experts must be those that were measured.
    Raises: DataError for a file that is no record of references; StorageError.
    """
    shipped, local = load_shipped(), load_local(folder)
    candidates = constant_names(get_family(spec.family).action_size)
    records = {}
    for task in spec.resolve_tasks():
        place = place_of(spec, task, spec.horizon)
        found: dict[str, Reference] = {}
        sources: tuple[tuple[Source, dict[Place, Entry]], ...]
        sources = (("shipped", shipped), ("local", local))
        for source, book in sources:
            if entry := book.get(place):
                found |= {name: score.reference(source) for name, score in entry.scores.items()}
        if not found:
            continue
        names = {"zero": "zero", "random": "random", "expert": expert_name(ladder, task)}
        records[task.name] = Record(
            {name: found[key] for name, key in names.items() if key in found},
            tuple(found[key] for key in candidates) if set(candidates) <= set(found) else (),
        )
    return records


def local_notice(records: Mapping[str, Record]) -> str:
    """How many tasks take references from the working folder, or nothing."""
    count = sum(
        any(reference.source == "local" for reference in (*r.by_name.values(), *r.constants))
        for r in records.values()
    )
    plural = "s" if count != 1 else ""
    return f"references of {count} task{plural} from ./{LOCAL_FILE}" if count else ""


def load_shipped() -> dict[Place, Entry]:
    """The entries mpdt comes with. Raises: as `load_entries`."""
    return load_entries(Path(str(resources.files("mpdt.data.weights"))) / "references.json")


def load_local(folder: Path | None = None) -> dict[Place, Entry]:
    """The entries of `folder`/LOCAL_FILE. Raises: as `load_entries`."""
    return load_entries((folder or Path()) / LOCAL_FILE)


def load_entries(path: Path) -> dict[Place, Entry]:
    """The entries of one file; none where there is no such file.

    Raises: DataError for a file that is no record of references; StorageError.
    """
    if not os.path.lexists(path):
        return {}
    entries = read_book(path, Entry, FORMAT, "record of references")
    return {entry.place: entry for entry in entries}


def check_target(path: Path) -> None:
    """Whether `save_entries` could write to `path` now: asked before hours of measuring.

    Raises: as `load_entries`; StorageError.
    """
    check_replaceable(path)
    load_entries(path)


def save_entries(path: Path, entries: Iterable[Entry], rule: str) -> None:
    """Write entries sorted by place, one per line; `rule` tells how they were measured. Atomic.

    Raises: StorageError where the disk refuses.
    """
    ordered = sorted(entries, key=lambda entry: entry.place)
    write_book(path, ordered, FORMAT, rule)
