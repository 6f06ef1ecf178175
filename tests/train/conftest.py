"""A small written file of cheetah_dir's shape: numbers from a generator, no simulator involved.

Two tasks (role both), medium and expert and random episodes of 6 to 9 steps, X of 2 episodes
per task. Expert actions are a fixed function of the observation and the task, so there is
something to learn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from makers import FINAL, UNIFORM, make_episode, source_of, tta_source_of

from mpdt.data.episode import Episode, PolicyInfo
from mpdt.data.reference import Reference, References
from mpdt.data.slices.stats import compute_stats
from mpdt.data.store.sources import FileHeader
from mpdt.data.store.tables import Additions, Slice, TaskRow
from mpdt.data.store.writer import write_file

D, A, HORIZON = 20, 6, 9
SPEC = {"name": "tiny", "horizon": HORIZON, "env": {}}
QUALITIES = {0: 2, 1: 2, 2: 4}  # code -> episodes per task


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def drawn_episode(task: int, quality: int, row: int, scale: float = 1.0) -> Episode:
    generator = np.random.Generator(np.random.PCG64([task, quality, row]))
    length = 6 + (row + task) % 4
    observations = generator.standard_normal((length + 1, D)).astype(np.float32)
    actions = scale * generator.uniform(-1, 1, (length, A)).astype(np.float32)
    if quality == 2:
        actions = np.tanh(observations[:-1, :A] * (1 if task == 0 else -1))
    ends = np.arange(length) == length - 1
    return make_episode(
        length, task=task, quality=quality, row=row, observations=observations,
        actions=actions.astype(np.float32), rewards=np.full(length, 1.0 + quality, np.float32),
        terminations=ends, truncations=np.zeros(length, bool),
        progress=quality / 2 if quality < 3 else -1.0,
        policy=FINAL if quality == 2 else UNIFORM,
    )  # fmt: skip


def references(zero: float, random: float, expert: float) -> References:
    """Errors of 0.5 from 16 episodes; the best constant action pushes along axis 1."""
    known = {"zero": zero, "random": random, "constant": 4.0, "expert": expert}
    by_name = {name: Reference(mean, 0.5, 16, source="shipped") for name, mean in known.items()}
    return References(by_name, (0.0, 1.0, 0.0, 0.0, 0.0, 0.0))


def write(
    path: Path,
    qualities: dict[int, int] = QUALITIES,
    tta: bool = True,
    paid: Callable[[Episode], Episode] = lambda episode: episode,
    spec: Mapping[str, Any] = SPEC,
) -> Path:
    """`paid`: gives X's episodes other rewards."""
    episodes = [drawn_episode(task, quality, row) for task in (0, 1)
                for quality, count in qualities.items() for row in range(count)]  # fmt: skip
    unseen = [paid(drawn_episode(task, 4, row, scale=3.0)) for task in (0, 1) for row in range(2)]
    header = FileHeader(
        family="cheetah_dir", name="tiny", version="1.0.0", license="CC0-1.0",
        spec=spec,
        observation_size=D, action_size=A, has_success=False,
        tasks=(
            TaskRow("forward", 0, "both", {}, references(0.0, -1.0, 9.0)),
            TaskRow("backward", 1, "both", {}, references(0.0, -2.0, 8.0)),
        ),
        policies=tuple(
            PolicyInfo(policy, task, rung, float(rung), -1, 0.0, name)
            for task in (0, 1) for policy, rung, name in ((UNIFORM, 0, "u"), (FINAL, 1, "f"))
        ),
    )  # fmt: skip
    x = tta_source_of(unseen, {0: 20.0, 1: 30.0}, {"action_scale": 3.0})
    write_file(
        path, header, source_of(episodes),
        {"default": x} if tta else {},
        finish=lambda dataset: Additions(
            slices={"few": Slice(np.array([0, len(episodes) // 2]), {"made": "by hand"})},
            stats=compute_stats(dataset),
        ),
    )  # fmt: skip
    return path


@pytest.fixture(scope="session")
def tiny_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("data") / "tiny.h5")


@pytest.fixture(scope="session")
def planned_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`tiny_file` with all that an entry of datasets.yaml says: root seed 7, blocks of 4."""
    counts = {"random": 2, "medium": 2, "expert": 4, "history": 0}
    spec = SPEC | {
        "version": "1.0.0", "family": "cheetah_dir", "seed": 7, "block": 4, "episodes": counts,
        "behaviour": {"network": "cheetah_dir", "script": None, "rungs": 3, "noise": 0.0},
        "license": "CC0-1.0", "tasks": "all", "test": None, "goals": None, "tta": {},
        "reference": 2,
    }  # fmt: skip
    return write(tmp_path_factory.mktemp("data") / "tiny.h5", spec=spec)


@pytest.fixture(scope="session")
def other_rewards_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`tiny_file` but for what the simulator paid in X."""

    def paid(episode: Episode) -> Episode:
        return replace(episode, rewards=episode.actions[:, episode.task].copy())

    return write(tmp_path_factory.mktemp("data") / "tiny.h5", paid=paid)


@pytest.fixture(scope="session")
def medium_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cut-out with one quality and no TTA set."""
    return write(tmp_path_factory.mktemp("data") / "tiny-medium.h5", {1: 2}, tta=False)
