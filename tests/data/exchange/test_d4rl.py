"""Flat HDF5 out and in; the two kinds of end, files that are cut off, files without timeouts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from mpdt.data.exchange import d4rl
from mpdt.data.exchange.treatment import Rules
from mpdt.data.spec.tasks import get_family
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset
from mpdt.errors import MpdtError

Make = Callable[..., Any]


def test_out_and_in_again_keeps_every_step(
    reach: Path, run: Make, imported: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("export", reach, "--to", "d4rl", "-o", "out") == 0
    assert "not in a d4rl export: seeds, policies" in capsys.readouterr().err
    data = open_dataset(reach)
    assert sorted(p.name for p in Path("out").iterdir()) == [
        "ml10-reach-expert.hdf5", "ml10-reach-random.hdf5",
    ]  # fmt: skip
    with h5py.File("out/ml10-reach-random.hdf5") as file:
        first, second = data.episode(0), data.episode(1)
        assert file["observations"].shape == (24, 39) and file["observations"].chunks is None
        np.testing.assert_array_equal(file["next_observations"][11], first.observations[12])
        np.testing.assert_array_equal(file["observations"][12], second.observations[0])
        assert np.flatnonzero(file["timeouts"]).tolist() == [11, 23]
        assert not file["terminals"][:].any()
        np.testing.assert_array_equal(file["infos/goal"][12:], np.tile(second.goal, (12, 1)))
    back: Dataset = imported("out", "--from", "d4rl", "--family", "ml10", "--horizon", 12)
    for i in range(4):
        one, wanted = back.episode(i), data.episode(i)
        for name in ("observations", "actions", "rewards", "truncations", "successes", "goal"):
            np.testing.assert_array_equal(getattr(one, name), getattr(wanted, name))
        assert one.quality == wanted.quality and one.policy != wanted.policy


def flat(path: Path, episodes: list[Any], **changes: Any) -> None:
    """Write dicts of the conftest one after another."""
    columns = {key: np.concatenate([e[key] for e in episodes]) for key in episodes[0]}
    columns = {key: columns[key][:, 0] if key in ("rewards", "terminals") else columns[key]
               for key in columns} | changes  # fmt: skip
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            if values is not None:
                file.create_dataset(name, data=values, compression="gzip")


ANT = ("--from", "d4rl", "--family", "ant_dir", "--task", "dir-07", "--horizon", 4)


@pytest.fixture
def ants(episode: Make) -> list[Any]:
    """A fall after 2 steps, a whole episode of 4 (the time limit), and 3 steps of another."""
    lengths = (2, 4, 3)
    return [episode(length, 100.0 * i, sizes=(27, 8)) for i, length in enumerate(lengths)]


def test_both_kinds_of_end_and_a_file_that_is_cut_off(
    tmp_path: Path, ants: list[Any], imported: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    flat(
        tmp_path / "a.hdf5", ants, terminals=np.array([0, 1, 0, 0, 0, 0, 0, 0, 0], bool),
        timeouts=np.array([0, 0, 0, 0, 0, 1, 0, 0, 0], bool),
    )  # fmt: skip
    data: Dataset = imported("a.hdf5", *ANT, "--quality", "medium")
    assert data.episodes.length.tolist() == [2, 4]
    assert data.steps.terminations.tolist() == [False, True, False, False, False, False]
    assert data.steps.truncations.tolist() == [False] * 5 + [True]
    assert data.tasks.names == ("dir-07",) and data.episodes.quality.tolist() == [1, 1]
    assert data.spec["import"]["sources"][0]["incomplete_steps_left_out"] == 3
    assert "left out the last 3 steps" in capsys.readouterr().err


def test_files_without_timeouts_are_cut_at_the_horizon(
    tmp_path: Path, ants: list[Any], imported: Make
) -> None:
    """No flag at row 5, where the next row starts elsewhere: four steps after the fall."""
    ends = np.array([0, 1, 0, 0, 0, 0, 0, 0, 1], np.float32)
    flat(tmp_path / "a.h5", ants, terminals=ends)
    data: Dataset = imported("a.h5", *ANT)
    assert data.episodes.length.tolist() == [2, 4, 3]
    assert np.flatnonzero(data.steps.terminations).tolist() == [1, 8]
    assert np.flatnonzero(data.steps.truncations).tolist() == [5]


def test_three_horizons_without_any_flag(tmp_path: Path, episode: Make, imported: Make) -> None:
    three = [episode(4, 100.0 * i) for i in range(3)] + [episode(1, 900.0)]
    flat(tmp_path / "a.hdf5", three, terminals=np.zeros(13, bool))
    words = ("--from", "d4rl", "--family", "cheetah_dir", "--task", "backward", "--horizon", 4)
    data: Dataset = imported("a.hdf5", *words)
    assert data.episodes.length.tolist() == [4, 4, 4]
    assert data.steps.truncations.sum() == 3 and data.goals.of(0).tolist() == [-1.0]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"next_observations": None}, "no next_observations"),
        ({"terminals": None}, "no terminals"),
        ({"timeouts": np.zeros(5, bool)}, "terminals and timeouts disagree"),
        ({"timeouts": np.ones(9, bool)}, "cut off before the time limit"),
        ({"rewards": np.full(9, np.inf)}, "a.hdf5: episode 0: 2 numbers in rewards are NaN"),
        ({"actions": np.zeros((9, 6))}, "expected shape (2, 8) in ant_dir"),
        ({"infos/goal": np.arange(9.0)}, "the goal changes within the episode"),
        ({"observations": np.zeros((9, 27))}, "starts elsewhere"),
    ],
)
def test_wrong_files(
    tmp_path: Path, ants: list[Any], run: Make, capsys: pytest.CaptureFixture[str],
    changes: dict[str, Any], text: str,
) -> None:  # fmt: skip
    ends = {"terminals": np.array([0, 1, 0, 0, 0, 0, 0, 0, 1], np.float32)}
    flat(tmp_path / "a.hdf5", ants, **(ends | changes))
    assert run("import", "a.hdf5", *ANT, "-o", "x.h5") == 1
    assert text in capsys.readouterr().err


def test_a_task_is_needed_and_a_family_has_to_fit(
    tmp_path: Path, ants: list[Any], collected: Path, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    flat(tmp_path / "a.hdf5", ants)
    assert run("import", "a.hdf5", *ANT[:4], "-o", "x.h5") == 2
    assert "of which task is a.hdf5?" in capsys.readouterr().err
    assert run("export", collected, "--to", "d4rl", "-o", "out") == 0
    assert run("import", "out", *ANT, "-o", "x.h5") == 1
    assert "expected ant_dir, found cheetah_dir" in capsys.readouterr().err


def test_a_shape_that_no_file_has_is_not_believed(
    tmp_path: Path, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        file.create_dataset("terminals", (1 << 50,), bool, chunks=(1 << 20,))
    assert run("import", "a.hdf5", *ANT, "-o", "x.h5") == 1
    assert "terminals is larger than its file can hold" in capsys.readouterr().err


def test_damage_is_one_of_our_errors_or_harmless(tmp_path: Path, ants: list[Any]) -> None:
    flat(tmp_path / "a.hdf5", ants)
    data = (tmp_path / "a.hdf5").read_bytes()
    rules = Rules(format="d4rl", family=get_family("ant_dir"), horizon=4, task="dir-07")
    rng = np.random.default_rng(0)
    refused = 0
    for place in rng.integers(4000, size=40).tolist():
        changed = bytearray(data)
        changed[place] ^= 1 << int(rng.integers(8))
        (tmp_path / "b.hdf5").write_bytes(changed)
        try:
            source = d4rl.read([tmp_path / "b.hdf5"], rules, "b").source
            episodes = list(source.episodes)
        except MpdtError:
            refused += 1
        else:
            assert len(episodes) == source.num_episodes, place
            assert sum(episode.length for episode in episodes) == source.num_steps, place
    assert 0 < refused < 40
