"""Small files of other projects, written as their published ones are."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mpdt.data.cli import main
from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.spec.entry import Behaviour, DatasetSpec, EpisodeCounts
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset


def foreign_episode(length: int, first: float = 0.0, sizes: tuple[int, int] = (20, 6)) -> Any:
    """A dict as in Prompt-DT's pickles: counting observations, rewards 1, 2, ..."""
    rows = first + np.arange((length + 1) * sizes[0], dtype=np.float32).reshape(length + 1, -1)
    ends = np.arange(length) == length - 1
    return {
        "observations": rows[:-1].copy(),
        "actions": np.full((length, sizes[1]), 0.25, np.float32),
        "rewards": np.arange(1, length + 1, dtype=np.float32)[:, None],
        "next_observations": rows[1:].copy(),
        "terminals": ends[:, None],
    }


@pytest.fixture
def episode() -> Callable[..., Any]:
    return foreign_episode


@pytest.fixture
def dump() -> Callable[[Any, Path], None]:
    """Write a pickle as Python 3.8 did, folders included."""

    def write(value: Any, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(value, protocol=4))

    return write


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """`mpdt-data` with these words, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("os.fsync", lambda handle: None)  # no test pulls the plug
    return lambda *words: main([str(word) for word in words])


@pytest.fixture
def imported(run: Callable[..., int]) -> Callable[..., Dataset]:
    """Import with these words and open the result."""

    def read(*words: object) -> Dataset:
        assert run("import", *words, "-o", "imported.h5") == 0
        return open_dataset("imported.h5")

    return read


@pytest.fixture(scope="session")
def reach(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four real Meta-World episodes of 12 steps, with successes and goals of their own."""
    path = tmp_path_factory.mktemp("reach") / "reach.h5"
    spec = DatasetSpec(
        name="reach", version="2.0.1", family="ml10", tasks=("reach",), horizon=12, seed=5,
        block=2, behaviour=Behaviour(script="metaworld"), reference=1, license="CC0-1.0",
        episodes=EpisodeCounts(random=2, expert=2),
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(path.parent)
        patch.setattr("os.fsync", lambda handle: None)
        return collect(make_job(spec), path, workers=0).dataset.path


@pytest.fixture(scope="session")
def cheetah(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two real random episodes of cheetah_dir's task forward, 12 steps each."""
    path = tmp_path_factory.mktemp("cheetah") / "cheetah.h5"
    spec = DatasetSpec(
        name="cheetah", version="1.0.0", family="cheetah_dir", tasks=("forward",), horizon=12,
        seed=5, block=2, behaviour=Behaviour(network="cheetah_dir"), reference=1, license="CC0-1.0",
        episodes=EpisodeCounts(random=2),
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(path.parent)
        patch.setattr("os.fsync", lambda handle: None)
        return collect(make_job(spec), path, workers=0).dataset.path
