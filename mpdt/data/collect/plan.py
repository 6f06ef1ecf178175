"""Plan: the blocks a dataset is made of, in canonical order. Pure: from the spec and the record.

    spec.episodes  random 120, block 50   ->  blocks 0 1 2 of 50, 50 and 20 rows
    spec.episodes  history, rungs 20      ->  blocks rung * 65536 + 0, 1, ...
    spec.tta       one set of 20          ->  block 0 of 20 rows, quality code 4
    spec.reference zero, random and expert where they are neither on record nor stored

A block is the unit of work, resume and hashing. Its seeds depend on its position only, so
more tasks, episodes or qualities leave every existing block as it was.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from mpdt.data.reference import Reference
from mpdt.data.sim.record import NOTHING, Record
from mpdt.data.spec.entry import DatasetSpec, EpisodeCounts, TtaRule, spec_hash
from mpdt.data.spec.tasks import Family, Task, get_family
from mpdt.seeding import HISTORY_STRIDE, Quality, SeedKey

REFERENCES = {
    "random": Quality.REFERENCE_RANDOM,
    "expert": Quality.REFERENCE_EXPERT,
    "zero": Quality.REFERENCE_ZERO,
}


@dataclass(frozen=True)
class Block:
    """`rows` consecutive episodes of one task and one policy."""

    kind: Literal["episodes", "tta", "reference"]
    name: str  # the quality, the TTA set or the reference
    task: Task
    quality: Quality  # third number of the seed key
    number: int
    rows: int
    horizon: int
    action_scale: float = 1.0
    unseen_goals: bool = False  # where a family numbers its goals: the held-out ones

    @property
    def label(self) -> str:
        """Name of the part: `forward-expert-0`, `forward-tta_default-0`, `forward-ref_zero-0`."""
        prefix = {"episodes": "", "tta": "tta_", "reference": "ref_"}[self.kind]
        return f"{self.task.name}-{prefix}{self.name}-{self.number}"

    @property
    def steps(self) -> int:
        """Env steps at most; episodes may end earlier."""
        return self.rows * self.horizon

    def keys(self, family: Family, seed: int) -> list[SeedKey]:
        first = SeedKey(seed, family.id, self.task.index, int(self.quality), self.number, 0)
        return [first.at_row(row) for row in range(self.rows)]


@dataclass(frozen=True)
class Plan:
    """Everything `collect` will do, before anything is done.

    Args:
        side_by_side: rows a policy is evaluated at; 0 = those of a block.
    """

    spec: DatasetSpec
    family: Family
    tasks: tuple[Task, ...]
    blocks: tuple[Block, ...]  # canonical order: ascending (task, quality, number)
    records: Mapping[str, Record] = field(default_factory=dict)  # references, by task name
    side_by_side: int = 0

    def on_record(self, task: Task) -> Record:
        """What is known of a task before any episode of this plan."""
        return self.records.get(task.name, NOTHING)

    @property
    def spec_hash(self) -> str:
        return spec_hash(self.spec)

    @property
    def width(self) -> int:
        """Rows a policy is evaluated at."""
        return self.side_by_side or self.spec.block

    def of_kind(self, kind: str, name: str | None = None) -> list[Block]:
        return [b for b in self.blocks if b.kind == kind and name in (None, b.name)]

    @property
    def num_episodes(self) -> int:
        return sum(block.rows for block in self.of_kind("episodes"))

    @property
    def num_tta_episodes(self) -> int:
        return sum(block.rows for block in self.of_kind("tta"))

    @property
    def num_steps(self) -> int:
        """Env steps at most, of all blocks."""
        return sum(block.steps for block in self.blocks)

    @property
    def file_bytes(self) -> int:
        """Size of the finished file at most."""
        stored = [block for block in self.blocks if block.kind != "reference"]
        steps, episodes = sum(block.steps for block in stored), sum(block.rows for block in stored)
        return most_bytes(self.family, steps, episodes)

    def seconds(self, workers: int) -> float:
        """Rough time to collect everything with `workers` processes."""
        return self.num_steps / self.family.steps_per_s / max(1, workers)


def most_bytes(family: Family, steps: int, episodes: int) -> int:
    """Size at most of a file of so many of each."""
    observation = 4 * family.observation_size
    step = observation + 4 * family.action_size + 4 + 2 + int(family.has_success)
    return steps * step + episodes * (observation + 200) + 1_000_000


def make_plan(spec: DatasetSpec, records: Mapping[str, Record] | None = None) -> Plan:
    """The blocks of a dataset.

    Args:
        records: result of `sim.record.find_records`; what is in it is not measured again.

    Raises: SpecError if the spec names an unknown family or task.
    """
    family, tasks = get_family(spec.family), spec.resolve_tasks()
    blocks: list[Block] = []
    for task in tasks:
        for name in EpisodeCounts.__struct_fields__:
            blocks += _episode_blocks(spec, task, name)
        for name, rule in sorted(spec.tta.items()):
            blocks += _tta_blocks(spec, task, name, rule)
        known = (records or {}).get(task.name, NOTHING).by_name
        blocks += _reference_blocks(spec, task, known)
    blocks.sort(key=lambda block: (block.task.index, block.quality, block.name, block.number))
    return Plan(spec=spec, family=family, tasks=tasks, blocks=tuple(blocks), records=records or {})


def spread(count: int, places: int) -> list[int]:
    """How many of `count` episodes each of `places` rungs gets, evenly and up to the last one.

    spread(5, 2) = [3, 2]; spread(3, 5) = [1, 0, 1, 0, 1]; spread(1, 5) = [1, 0, 0, 0, 0]
    """
    each, rest = divmod(count, places)
    counts = [each] * places
    for extra in range(rest):
        counts[round(extra * (places - 1) / max(1, rest - 1))] += 1
    return counts


def cut(rows: int, size: int) -> Iterator[tuple[int, int]]:
    """(number, rows) of each block: full ones, then the rest."""
    for number in range(-(-rows // size)):
        yield number, min(size, rows - number * size)


def _episode_blocks(spec: DatasetSpec, task: Task, name: str) -> Iterator[Block]:
    quality = Quality[name.upper()]
    count = spec.episodes.of(name)
    per_rung: Sequence[int] = [count]
    if name == "history":
        per_rung = spread(count, spec.behaviour.rungs)
    for rung, episodes in enumerate(per_rung):
        for number, rows in cut(episodes, spec.block):
            position = rung * HISTORY_STRIDE + number
            yield Block("episodes", name, task, quality, position, rows, spec.horizon)


def _tta_blocks(spec: DatasetSpec, task: Task, name: str, rule: TtaRule) -> Iterator[Block]:
    # A task of role "both" is a train task and a test task.
    if rule.tasks != "all" and task.role not in (rule.tasks, "both"):
        return
    horizon = rule.horizon or spec.horizon
    for number, rows in cut(rule.episodes, spec.block):
        yield Block(
            "tta", name, task, Quality.TTA, number, rows, horizon, action_scale=rule.action_scale,
            unseen_goals=rule.tasks != "train",
        )  # fmt: skip


def _reference_blocks(
    spec: DatasetSpec, task: Task, known: Mapping[str, Reference]
) -> Iterator[Block]:
    for name, quality in REFERENCES.items():
        if name in known or (name != "zero" and spec.episodes.of(name) > 0):
            continue  # on record, or the stored episodes say it better
        for number, rows in cut(spec.reference, spec.block):
            yield Block("reference", name, task, quality, number, rows, spec.horizon)
