"""A hand-made file: two cheetah_dir-like tasks, D = 2, A = 1, episodes of 1, 2 and 3 steps."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from makers import FINAL, UNIFORM, make_episode, source_of, tta_source_of

from mpdt.data.episode import PolicyInfo
from mpdt.data.reference import Reference, References
from mpdt.data.store.reader import Dataset, open_dataset
from mpdt.data.store.sources import FileHeader, TtaSource
from mpdt.data.store.tables import TaskRow
from mpdt.data.store.writer import write_file

REFERENCES = References(
    {
        "random": Reference(-1.0, 0.25, 16, source="shipped"),
        "zero": Reference(0.0, 0.0, 16, source="shipped"),
        "expert": Reference(9.0, 0.5, 64, 0.75, "collected"),
        "constant": Reference(1.5, 0.125, 32, source="shipped"),
    },
    (0.5,),
)

HEADER = FileHeader(
    family="cheetah_dir",
    name="hand-made",
    version="1.0.0",
    license="CC0-1.0",
    spec={"name": "hand-made", "seed": 3},
    observation_size=2,
    action_size=1,
    has_success=False,
    tasks=(
        TaskRow("forward", 0, "both", {"entry_point": "x:y", "kwargs": {"task": "forward"}}),
        TaskRow("backward", 1, "both", {}, REFERENCES),
    ),
    policies=(
        PolicyInfo(UNIFORM, 0, 0, 0.0, -1, 1.0, "uniform"),
        PolicyInfo(FINAL, 0, 19, 1.0, 3_200_000, 0.0, "ppo-3.2M"),
        PolicyInfo(UNIFORM, 1, 0, 0.0, -1, 1.0, "uniform"),
    ),
)

EPISODES = (
    make_episode(1, 100.0),
    make_episode(2, 200.0, row=1),
    make_episode(3, 300.0, quality=2, policy=FINAL, progress=1.0),
    make_episode(1, 400.0, task=1),
)


def tta_source() -> TtaSource:
    one, two = make_episode(2, 500.0, quality=4), make_episode(1, 600.0, quality=4, row=1)
    other = make_episode(1, 700.0, task=1, quality=4, goal=np.array([0.5]))
    return tta_source_of((one, two, other), {0: 1500.0, 1: 0.25}, {"action_scale": 3.0})


@pytest.fixture(scope="session")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("store") / "hand-made.h5"
    return write_file(path, HEADER, source_of(EPISODES), {"default": tta_source()}).path


@pytest.fixture
def made(original: Path, tmp_path: Path) -> Dataset:
    """An own copy: every write waits for the disk, so it is written once only."""
    return open_dataset(shutil.copy(original, tmp_path))


@pytest.fixture
def kit() -> SimpleNamespace:
    """The hand-made parts."""
    return SimpleNamespace(
        episode=make_episode, header=HEADER, episodes=EPISODES, tta=tta_source,
        source=lambda episodes=EPISODES: source_of(episodes), uniform=UNIFORM, final=FINAL,
    )  # fmt: skip
