"""Foreign files: several of them become one file of a family, with what they do not say unknown.

    files -> Source (path, task, quality) -> checked twice: counted first, then written

Unknown stays unknown: quality and progress -1, no seed key, no policy, no reference returns.
Which files, and what was changed in them, is in the new file's spec under `import`.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mpdt.data.episode import (
    QUALITY_CODES,
    UNKNOWN_POLICY,
    UNKNOWN_PROGRESS,
    UNKNOWN_QUALITY,
    Episode,
    PolicyInfo,
)
from mpdt.data.exchange.incoming import Incoming
from mpdt.data.exchange.treatment import RawEpisode, Rules, Treated, treat
from mpdt.data.spec.env import describe_env
from mpdt.data.spec.family import own_definition
from mpdt.data.spec.tasks import Task
from mpdt.data.store import provenance
from mpdt.data.store.licence import combined
from mpdt.data.store.sources import EpisodeSource, FileHeader
from mpdt.data.store.tables import TaskRow
from mpdt.disk import sha256
from mpdt.errors import DataError, UsageError, unknown_name
from mpdt.seeding import UNKNOWN_SEED_KEY, Quality

_OWN_PACKAGES = ("mpdt", "python", "numpy", "h5py", "hdf5")
"""What read the files. The simulator that made them is unknown, so none is named."""


@dataclass(frozen=True)
class Source:
    """One file of episodes of one task and quality.

    Args:
        quality: a code of `QUALITY_CODES`, or -1.
        read: its episodes; called twice.
        license: as the source says it; "" = as the rules do.
        name: what the spec of the new file calls it; "" = the file's own name.
        notes: what else the spec should say about it; a `sha256` of all its files, where `path`
            is not all of it.
    """

    path: Path
    task: Task
    quality: int
    read: Callable[[], Iterator[RawEpisode]]
    license: str = ""
    name: str = ""
    notes: Mapping[str, Any] = field(default_factory=dict)


@dataclass
class _Tally:
    """What the first reading found in one source."""

    source: Source
    kept: list[bool]
    seeds: list[int] = field(default_factory=list)
    """Of those kept, where they are known."""
    has_success: bool = False
    steps: int = 0
    clipped_numbers: int = 0
    clipped_episodes: int = 0
    largest_action: float = 0.0

    def record(self) -> dict[str, Any]:
        """The source for the spec: no folder, which would tell who imported it where."""
        found: dict[str, Any] = {
            "name": self.source.name or self.source.path.name,
            "sha256": sha256(self.source.path),
            "task": self.source.task.name,
            "quality": quality_name(self.source.quality),
            "episodes": sum(self.kept),
            **self.source.notes,
        }
        if self.source.license:
            found["license"] = self.source.license
        if len(self.kept) != sum(self.kept):
            found["duplicates_left_out"] = len(self.kept) - sum(self.kept)
        if self.clipped_numbers:
            found["clipped"] = {
                "episodes": self.clipped_episodes,
                "numbers": self.clipped_numbers,
                "largest": round(self.largest_action, 4),
            }
        return found


def quality_code(name: str) -> int:
    """Raises: UsageError naming the nearest quality."""
    known = QUALITY_CODES | {"unknown": UNKNOWN_QUALITY}
    if name not in known:
        raise unknown_name("quality", name, known, where="--quality")
    return known[name]


def quality_name(code: int) -> str:
    names = {number: name for name, number in QUALITY_CODES.items()}
    return names.get(code, "unknown")


def given(rules: Rules | None) -> Rules:
    """Raises: UsageError where there are none: a foreign file does not name its family."""
    if rules is None:
        raise UsageError("of which family?", where="--family", hint="--family cheetah_vel")
    return rules


def incoming(
    sources: Sequence[Source], rules: Rules, name: str, remarks: Sequence[str] = ()
) -> Incoming:
    """All episodes of `sources` as one file of the family, each kept once per task.

    Every file is read and checked before anything is written, and read again for writing.

    Raises: DataError and ShapeError naming file and episode; UsageError without any source.
    """
    if not sources:
        hint = "" if remarks else "name files, or a folder with files in it"
        raise UsageError(f"nothing to import as {rules.format}", found="; ".join(remarks[:3]),
                         hint=hint)  # fmt: skip
    ordered = sorted(sources, key=lambda s: (s.task.index, s.quality, natural(str(s.path))))
    seen: set[tuple[int, bytes]] = set()
    tallies = [_count(source, rules, seen) for source in ordered]
    if len({tally.has_success for tally in tallies}) > 1:
        lacking = next(tally for tally in tallies if not tally.has_success)
        raise DataError("some of the files tell success and some do not",
                        where=str(lacking.source.path),
                        hint="import them into two files")  # fmt: skip
    tasks = {tally.source.task.index: tally.source.task for tally in tallies}
    episodes = EpisodeSource(
        _episodes(tallies, rules), sum(sum(t.kept) for t in tallies), sum(t.steps for t in tallies)
    )
    header = _header(rules, name, [tasks[index] for index in sorted(tasks)], tallies)
    return Incoming(header, episodes, remarks=(*remarks, *_told(tallies)))


def _count(source: Source, rules: Rules, seen: set[tuple[int, bytes]]) -> _Tally:
    tally = _Tally(source, [])
    for number, raw in enumerate(source.read()):
        where = f"{source.path}: episode {number}"
        found = treat(raw, rules, where)
        _check_goal(raw, source.task, where)
        digest = hashlib.sha256(found.observations.tobytes() + found.actions.tobytes()).digest()
        new = (source.task.index, digest) not in seen
        seen.add((source.task.index, digest))
        tally.kept.append(new)
        if new and raw.seed is not None:
            tally.seeds.append(raw.seed)
        tally.steps += len(found.rewards) * new
        if not number:
            tally.has_success = found.successes is not None
        elif tally.has_success != (found.successes is not None):
            raise DataError("some episodes tell success and some do not", where=str(source.path))
        tally.clipped_numbers += found.clipped
        tally.clipped_episodes += found.clipped > 0
        tally.largest_action = max(tally.largest_action, found.largest)
    if not tally.kept:
        raise DataError("a file without episodes", where=str(source.path))
    return tally


def _check_goal(raw: RawEpisode, task: Task, where: str) -> None:
    """Raises: DataError for the goal of another task; those of Meta-World differ by episode."""
    if raw.goal is None or not task.goal:
        return
    known = np.array(task.goal)
    if raw.goal.shape != known.shape or not np.allclose(raw.goal, known, rtol=0, atol=1e-6):
        raise DataError(f"another goal than that of task {task.name}", where=where,
                        expected=str(known.tolist()), found=str(raw.goal.tolist()),
                        hint="name the task of that goal with --task")  # fmt: skip


def _seeds(tallies: Sequence[_Tally], rules: Rules) -> list[list[str]]:
    """By source and episode, as text; empty unless all are known and asked for."""
    known = all(len(tally.seeds) == sum(tally.kept) for tally in tallies)
    if not (rules.with_seeds and known):
        return []
    return [[str(seed) for seed in tally.seeds] for tally in tallies]


def _episodes(tallies: Sequence[_Tally], rules: Rules) -> Iterator[Episode]:
    has_seeds = bool(_seeds(tallies, rules))
    for place, tally in enumerate(tallies):
        source, row = tally.source, 0
        for number, (raw, kept) in enumerate(zip(source.read(), tally.kept, strict=True)):
            if kept:
                treated = treat(raw, rules, f"{source.path}: episode {number}")
                found = _episode(source, raw, treated)
                if has_seeds:
                    key = (rules.family.id, source.task.index, int(Quality.RECORDED), place, row)
                    found = replace(found, seed_key=key)
                yield found
                row += 1


def _episode(source: Source, raw: RawEpisode, found: Treated) -> Episode:
    goal = np.array(source.task.goal, np.float64) if raw.goal is None else raw.goal
    return Episode(
        observations=found.observations, actions=found.actions, rewards=found.rewards,
        terminations=found.terminations, truncations=found.truncations,
        successes=found.successes, task=source.task.index, goal=goal, quality=source.quality,
        progress=UNKNOWN_PROGRESS, policy=UNKNOWN_POLICY,
        seed_key=UNKNOWN_SEED_KEY,
    )  # fmt: skip


def _header(
    rules: Rules, name: str, tasks: Sequence[Task], tallies: Sequence[_Tally]
) -> FileHeader:
    family, nan, told = rules.family, float("nan"), own_definition(rules.family)

    def task_row(task: Task) -> TaskRow:
        env = describe_env({"horizon": rules.horizon}, family.name, task.name, told)
        return TaskRow(task.name, task.index, task.role, env)

    versions, seeds = provenance.packages(), _seeds(tallies, rules)
    return FileHeader(
        family=family.name, name=name, version="0.0.0",
        license=combined(tally.source.license or rules.license for tally in tallies),
        spec={
            "name": name,
            "family": family.name,
            **({} if rules.any_length else {"horizon": rules.horizon}),
            "import": {
                "from": rules.format,
                "clip_actions": rules.clip_actions,
                "hide_goal": rules.hide_goal,
                "sources": [tally.record() for tally in tallies],
                **({"seeds": seeds} if seeds else {}),
            },
        },
        observation_size=family.observation_size, action_size=family.action_size,
        has_success=tallies[0].has_success,
        tasks=[task_row(task) for task in tasks],
        policies=[
            PolicyInfo(UNKNOWN_POLICY, task.index, -1, nan, -1, nan, "unknown") for task in tasks
        ],
        packages={package: versions[package] for package in _OWN_PACKAGES if package in versions},
        platform={},
        definition=told,
    )  # fmt: skip


def _told(tallies: Sequence[_Tally]) -> Iterator[str]:
    again = [tally for tally in tallies if not all(tally.kept)]
    if again:
        count = sum(tally.kept.count(False) for tally in again)
        where = str(again[0].source.path)
        where += f" and {len(again) - 1} more files" if len(again) > 1 else ""
        yield f"{where}: left out {count} episodes that are there already"
    for tally in tallies:
        path = tally.source.path
        if tally.clipped_numbers:
            yield (
                f"{path}: clipped {tally.clipped_numbers} numbers in the actions of "
                f"{tally.clipped_episodes} episodes, up to {tally.largest_action:.3g}"
            )


def natural(name: str) -> list[tuple[int, str]]:
    """`x-2` before `x-10`."""
    words = re.split(r"(\d+)", name)
    return [(int(word), "") if word.isdigit() else (-1, word) for word in words]
