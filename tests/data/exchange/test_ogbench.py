"""OGBench's files: rows, ends, and what is held out. Its own loader is in make ecosystem."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mpdt.data.exchange import ogbench
from mpdt.data.store.reader import open_dataset

Make = Callable[..., Any]


def test_a_pair_per_task_and_quality(
    collected: Path, run: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four episodes of five steps; every third one is held out: 0 and 3."""
    assert ogbench.HELD_OUT == 10
    monkeypatch.setattr(ogbench, "HELD_OUT", 3)
    assert run("export", collected, "--to", "ogbench", "-o", "out") == 0
    assert len(list(Path("out").iterdir())) == 16  # tasks, qualities, pairs
    data = open_dataset(collected)
    ids = data.select(task="backward", quality="expert").tolist()
    for name, wanted in (("", ids[1:3]), ("-val", [ids[0], ids[3]])):
        with np.load(f"out/cheetah_dir-backward-expert-v1{name}.npz") as file:
            found = dict(file)
        assert found["terminals"].tolist() == ([False] * 5 + [True]) * 2
        for row, i in zip((0, 6), wanted, strict=True):
            one = data.episode(i)
            np.testing.assert_array_equal(found["observations"][row : row + 6], one.observations)
            np.testing.assert_array_equal(found["actions"][row : row + 5], one.actions)
            np.testing.assert_array_equal(found["rewards"][row : row + 5], one.rewards)
            assert not found["actions"][row + 5].any() and found["rewards"][row + 5] == 0
        assert [found[key].dtype.str for key in ("observations", "actions")] == ["<f4", "<f4"]


def test_one_episode_alone_is_in_both(collected: Path, run: Make) -> None:
    assert run("split", collected, "--quality", "expert", "--episodes", 1, "-o", "one.h5") == 0
    assert run("export", "one.h5", "--to", "ogbench", "-o", "out") == 0
    with (
        np.load("out/cheetah_dir-forward-expert-v1.npz") as kept,
        np.load("out/cheetah_dir-forward-expert-v1-val.npz") as held_out,
    ):
        np.testing.assert_array_equal(kept["observations"], held_out["observations"])
        assert len(kept["observations"]) == 6
