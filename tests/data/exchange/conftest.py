"""Small files of other projects, written as their published ones are."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mpdt.data.cli import main
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset

FLAT_KEYS = ("observations", "next_observations", "actions", "rewards", "terminals")


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
