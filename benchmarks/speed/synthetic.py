"""Made-up data for benchmarks: episodes of random numbers in the shape of a family.

Rates of storing and reading do not depend on what the numbers mean, and simulating gigabytes
would take longer than all benchmarks together.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mpdt.data.collect.plan import Block
from mpdt.data.episode import Episode, PolicyInfo
from mpdt.data.slices.standard import standard_additions
from mpdt.data.spec.tasks import Family, get_family
from mpdt.data.store import columns, layout
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.digest import content_hash
from mpdt.data.store.digests import Labels, array_digests
from mpdt.data.store.reader import open_dataset
from mpdt.data.store.seal import seal
from mpdt.data.store.sources import EpisodeSource, FileHeader
from mpdt.data.store.tables import TaskRow
from mpdt.data.store.writer import ALIGNED, write_file
from mpdt.seeding import Quality

POLICY = bytes(range(32))
EXPERT = int(Quality.EXPERT)


_EPISODES = 1 << 15  # of a pool, none like another


class Numbers:
    """A pool of random rows; an episode is a view of it, so that making one costs nothing."""

    def __init__(self, family: Family, horizon: int) -> None:
        generator = np.random.default_rng(0)
        rows = _EPISODES + horizon
        self.family, self.horizon = family, horizon
        self._observations = generator.standard_normal((rows, family.observation_size), np.float32)
        actions = generator.uniform(-1, 1, (rows, family.action_size))
        self._actions = actions.astype(np.float32)
        self._rewards = generator.random(rows, np.float32)
        self._ends = np.arange(horizon) == horizon - 1
        self._never = np.zeros(horizon, bool)

    def episode(self, task: int, number: int, key: tuple[int, int, int, int, int]) -> Episode:
        first = number % _EPISODES
        steps = slice(first, first + self.horizon)
        return Episode(
            observations=self._observations[first : first + self.horizon + 1],
            actions=self._actions[steps], rewards=self._rewards[steps],
            terminations=self._never, truncations=self._ends,
            successes=self._never if self.family.has_success else None,
            task=task, goal=np.array([float(number % 50)]), quality=key[2], progress=1.0,
            policy=POLICY, seed_key=key,
        )  # fmt: skip

    def of_block(self, block: Block) -> list[Episode]:
        """What a worker would have simulated."""
        keys, before = block.keys(self.family, 0), 1000 * block.task.index + 50 * block.number
        return [self.episode(block.task.index, before + key.row, key.spawn_key) for key in keys]


def policies(family: Family) -> list[PolicyInfo]:
    return [PolicyInfo(POLICY, task.index, 0, 1.0, -1, 0.0, "made up") for task in family.tasks]


def header(family: Family) -> FileHeader:
    return FileHeader(
        family=family.name, name=f"bench_{family.name}", version="1.0.0", license="MIT",
        spec={"family": family.name}, observation_size=family.observation_size,
        action_size=family.action_size, has_success=family.has_success,
        tasks=[TaskRow(task.name, task.index, task.role, {}) for task in family.tasks],
        policies=policies(family),
    )  # fmt: skip


def write(path: Path, family_name: str, per_task: int, horizon: int, first: int = 0) -> Dataset:
    """A whole file: `per_task` expert episodes of every task, slices and statistics.

    Args:
        first: number of each task's first episode; files of other numbers can be merged.
    """
    family = get_family(family_name)
    numbers = Numbers(family, horizon)

    def episodes() -> Iterator[Episode]:
        for task in family.tasks:
            for row in range(first, first + per_task):
                key = (family.id, task.index, EXPERT, row // 50, row % 50)
                yield numbers.episode(task.index, task.index * per_task + row, key)

    count = per_task * len(family.tasks)
    source = EpisodeSource(episodes(), count, count * horizon)
    return write_file(path, header(family), source, None, standard_additions)


_ROWS = 1 << 18  # written together


def grown(path: Path, model: Path, per_task: int) -> Dataset:
    """As `hollow`, but with numbers in its steps and their digests: nothing in it is wrong.

    Quicker than `write` by what Episode objects take, so that a million of them can be made.
    """
    small = open_dataset(model)
    row = 4 * (small.observation_size + small.action_size + 1) + 2
    size = row * int(small.episodes.length[0]) * len(small.tasks) * per_task
    made = hollow(path, model, size)
    generator = np.random.default_rng(0)
    with h5py.File(path, "r+") as file:
        for rows in (file[f"steps/{name}"] for name in ("observations", "actions", "rewards")):
            for first in range(0, len(rows), _ROWS):
                shape = (min(_ROWS, len(rows) - first), *rows.shape[1:])
                rows[first : first + _ROWS] = 2 * generator.random(shape, np.float32) - 1
        lengths = made.episodes.length
        file["steps/truncations"][np.cumsum(lengths) - 1] = True
        starts, rewards = np.cumsum(lengths) - lengths, file["steps/rewards"][:]
        file["episodes/return"][:] = np.add.reduceat(rewards.astype(np.float64), starts)
        file["episodes/seed_key"][:] = _seed_keys(made)
        seal(file)
    made = open_dataset(path)
    labels, steps = Labels(made), made.steps
    arrays = [(column.path, np.asarray(getattr(steps, column.path))) for column in layout.STEPS
              if getattr(steps, column.path) is not None]  # fmt: skip
    every = [labels.episode(i) for i in range(made.num_episodes)]
    digests = np.frombuffer(array_digests(arrays, lengths.tolist(), every), np.uint8)
    with h5py.File(path, "r+") as file:
        file["episodes/digest"][:] = digests.reshape(-1, 32)
        file.attrs["content_hash"] = content_hash(made.content_header(), digests.reshape(-1, 32))
        seal(file)
    return open_dataset(path)


def _seed_keys(made: Dataset) -> Any:
    """(E, 5), as collecting gives them: family, task, quality, block, row."""
    family = get_family(made.family)
    task, ids = made.episodes.task, np.arange(made.num_episodes)
    number = ids - np.searchsorted(task, task)  # within its task
    return np.stack([np.full(len(ids), family.id), np.array(made.tasks.indices)[task],
                     np.full(len(ids), EXPERT), number // 50, number % 50], axis=1)  # fmt: skip


def hollow(path: Path, model: Path, num_bytes: int) -> Dataset:
    """A file of about `num_bytes` whose steps are holes: all tables are there and hang together.

    Everything but steps, episodes and slices is copied from the file `model`, whose tasks and
    episode length it has. It takes no room on the disk beyond its tables, and `open_dataset`
    cannot tell it from one that was written.
    """
    small = open_dataset(model)
    horizon, tasks = int(small.episodes.length[0]), len(small.tasks)
    row = 4 * (small.observation_size + small.action_size + 1) + 2
    per_task = max(1, num_bytes // (row * horizon * tasks))
    count = per_task * tasks
    ids = np.arange(count)
    table: dict[str, Any] = {
        "task": ids // per_task, "policy": ids // per_task, "goal": np.zeros(count),
        "start": ids * horizon, "obs_start": ids * (horizon + 1),
        "length": np.full(count, horizon), "quality": np.full(count, EXPERT),
        "progress": np.ones(count), "return": np.zeros(count), "success": np.zeros(count, bool),
        "seed_key": np.stack([ids] * 5, axis=1), "source": None,
        "digest": np.random.default_rng(0).integers(0, 256, (count, 32), np.uint8),
    }  # fmt: skip
    sizes = {"N": count * horizon, "E": count, "R": count * (horizon + 1),
             "D": small.observation_size, "A": small.action_size}  # fmt: skip
    with h5py.File(model, "r") as old, h5py.File(path, "w", **ALIGNED) as new:
        for name in ("tasks", "goals", "policies", "stats"):
            old.copy(name, new)
        for name, value in old.attrs.items():
            new.attrs[name] = value
        steps = new.create_group("steps")
        for column in layout.STEPS:
            if not column.optional or small.steps.successes is not None:
                columns.create(steps, column, sizes)
        columns.write_table(new.create_group("episodes"), layout.EPISODES, table)
        new["episodes/quality"].attrs["codes"] = old["episodes/quality"].attrs["codes"]
        new.attrs["content_hash"] = content_hash(small.content_header(), table["digest"])
        seal(new)
    return open_dataset(path)
