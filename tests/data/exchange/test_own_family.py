"""Foreign data as a family of its own: what is made of it, and what is refused in which words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from own_families import forgotten, line

import mpdt
from mpdt.data.cli import main
from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.exchange import formats
from mpdt.data.exchange.incoming import store
from mpdt.data.exchange.own_family import read
from mpdt.data.exchange.own_sources import Asked
from mpdt.data.exchange.selection import Selection
from mpdt.data.slices.standard import standard_additions
from mpdt.data.spec.entry import Behaviour, DatasetSpec, EpisodeCounts
from mpdt.data.spec.tasks import FAMILIES
from mpdt.data.store.dataset import Dataset
from mpdt.data.verify.verify import verify
from mpdt.errors import MpdtError, SimulatorError


@pytest.fixture(autouse=True)
def forget() -> Any:
    with forgotten():
        yield


def flat(episodes: int = 2, steps: int = 3, **changes: Any) -> dict[str, Any]:
    """Observations count up; rewards are 1; the last episode ends by its own rule."""
    rows = episodes * steps
    seen = np.arange(rows * 2, dtype=np.float32).reshape(rows, 2)
    last = np.arange(1, rows + 1) % steps == 0
    over = last & (np.arange(rows) >= rows - steps)
    following = seen + 2
    found = {
        "observations": seen, "next_observations": following,
        "actions": np.full((rows, 1), 0.5, np.float32), "rewards": np.ones(rows, np.float32),
        "terminals": over, "timeouts": last & ~over,
    }  # fmt: skip
    return {key: value for key, value in (found | changes).items() if value is not None}


def brought(folder: Path, **asked: Any) -> Dataset:
    fields: dict[str, Any] = {"format": "npz", "name": "mine"} | asked
    found = read([folder], Asked(**fields), "mine")
    return store(found, folder.parent / "mine.h5", standard_additions)


def test_names_bounds_and_references_are_what_the_data_have(tmp_path: Path) -> None:
    folder = tmp_path / "sets"
    folder.mkdir()
    np.savez(folder / "left-expert-v2.npz", **flat())
    other = np.full((6, 1), 0.25, np.float32)
    np.savez(folder / "left-random-v2.npz", **flat(rewards=np.arange(6, dtype="f4"), actions=other))
    np.savez(
        folder / "right.npz",
        **flat(actions=np.full((6, 1), -2.5, np.float32), rewards=np.full(6, 9, np.float32)),
    )
    data = brought(folder, test=("right",))
    family = data.contract()
    assert list(data.tasks.names) == ["left", "right"]
    assert [task.role for task in data.contract().tasks] == ["train", "test"]
    assert not family.simulates and (family.action_low, family.action_high) == (-2.5, 2.5)
    assert family.horizon == 3 and family.ends_early and family.columns == ("o0 [1]", "o1 [1]")
    # Of left's episodes alone, which return 3, 3, 0 + 1 + 2 and 3 + 4 + 5.
    assert family.return_target == 12.0
    left, right = data.tasks.references
    assert (left["random"].mean, left["expert"].mean, left["expert"].source) == (7.5, 3.0, "data")
    assert not right["expert"].is_known
    assert data.episodes.quality.tolist() == [0, 0, 2, 2, -1, -1]
    assert data.episode(2).observations.tolist() == [[0, 1], [2, 3], [4, 5], [6, 7]]
    assert data.episode(3).terminations.tolist() == [False, False, True]
    assert data.episode(3).truncations.tolist() == [False, False, True]  # the limit is 3, too
    outcome = {one.id: one.outcome.value for one in verify(data.path).findings}
    assert "FAIL" not in outcome.values() and outcome["replay"] == "NONE"
    with pytest.raises(SimulatorError, match="nobody simulates this family"):
        mpdt.data.sim.simulators.make_batch(family, family.tasks, {})
    batch = mpdt.windows(data, window=2, per_task=2, quality="expert").batch(0)
    assert batch.observations.shape == (1, 2, 2, 2)


def test_returns_below_zero_and_actions_within_one(tmp_path: Path) -> None:
    """Two episodes return 1 and -15."""
    folder = tmp_path / "sets"
    folder.mkdir()
    np.savez(
        folder / "left-medium-expert.npz", **flat(rewards=np.array([0, 0, 1] + [-5] * 3, "f4"))
    )
    data = brought(folder)
    family = data.contract()
    assert (family.return_target, family.return_scale) == (1.0, 16.0)
    assert (family.action_low, family.action_high) == (-1.0, 1.0)
    # Two words for a quality are none.
    assert data.tasks.names == ("left-medium-expert",)
    assert data.episodes.quality.tolist() == [-1, -1]


def test_a_time_limit_that_is_said(tmp_path: Path) -> None:
    """Seven steps without an end of their own, cut off after three; the last one is left out."""
    folder = tmp_path / "sets"
    folder.mkdir()
    arrays = flat(1, 7, timeouts=None, terminals=np.zeros(7, bool))
    np.savez(folder / "left.npz", successes=np.arange(7) == 4, **arrays)
    data = brought(folder, horizon=3)
    assert data.episodes.length.tolist() == [3, 3] and not data.contract().ends_early
    assert data.episode(1).observations[0].tolist() == [6, 7]
    assert data.episode(1).truncations.tolist() == [False, False, True]
    assert data.steps.successes is not None
    assert data.steps.successes.tolist() == [False] * 4 + [True, False]


@pytest.mark.parametrize("format", ["npz", "d4rl"])
def test_both_flags_at_one_step_stay_both(format: str, tmp_path: Path) -> None:
    """Two episodes, the second ends by its own rule too; the limit is four."""
    folder = tmp_path / "sets"
    folder.mkdir()
    arrays = flat(timeouts=np.arange(1, 7) % 3 == 0)
    np.savez(folder / "left.npz", **arrays)
    with h5py.File(folder / "left.hdf5", "w") as file:
        for name, values in arrays.items():
            file[name] = values
    (folder / {"npz": "left.hdf5", "d4rl": "left.npz"}[format]).unlink()
    data = brought(folder, format=format, horizon=4)
    one, two = data.episode(0), data.episode(1)
    assert one.truncations.tolist() == two.truncations.tolist() == [False, False, True]
    assert not one.terminations.any() and two.terminations.tolist() == [False, False, True]


def test_a_flat_file_that_does_not_say_where_it_was_cut(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "left.hdf5", "w") as file:
        for name, values in flat(timeouts=None).items():
            file[name] = values
    with pytest.raises(MpdtError, match="does not say where episodes were cut off"):
        read([tmp_path], Asked(format="d4rl", name="mine"), "mine")


def test_an_archive_that_holds_too_much(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "left.npz", **flat(), more=np.zeros(1_000_000))
    with pytest.raises(MpdtError, match="more than it can hold"):
        read([tmp_path], Asked(format="npz", name="mine"), "mine")


@pytest.mark.parametrize("format", ["minari", "d4rl"])
def test_sets_and_flat_files(format: str, tmp_path: Path) -> None:
    mpdt.register_family(line(has_success=True))
    spec = DatasetSpec(
        name="theirs", version="1.0.0", family="line", horizon=8, seed=3, block=4, reference=3,
        behaviour=Behaviour(script="there", rungs=3), license="CC0-1.0",
        episodes=EpisodeCounts(random=3, expert=2),
    )  # fmt: skip
    data = collect(make_job(spec), tmp_path / "theirs.h5", workers=0).dataset
    formats.write(format, Selection(data, np.arange(data.num_episodes), ""), tmp_path / "sets")
    FAMILIES.pop("line")
    found = brought(tmp_path / "sets", format=format)
    steps, theirs = found.steps, data.steps
    assert found.num_episodes == data.num_episodes == 15 and found.contract().has_success
    assert len(found.tasks.names) == 3 and sorted(set(found.episodes.quality)) == [0, 2]
    order = [data.tasks.names.index(name.split("-")[-1]) for name in found.tasks.names]
    one = found.episode(int(found.select(task=found.tasks.names[0], quality="expert")[0]))
    two = data.episode(int(data.select(task=data.tasks.names[order[0]], quality="expert")[0]))
    assert (one.observations == two.observations).all() and (one.rewards == two.rewards).all()
    assert steps.actions.shape == theirs.actions.shape
    if format == "minari":  # line/left/expert
        asked = Asked(format=format, name="mine", task_from="folder")
        tasks = read([tmp_path / "sets"], asked, "mine").header.tasks
        assert [task.name for task in tasks] == ["far", "left", "right"]


@pytest.mark.parametrize(
    ("arrays", "asked", "told"),
    [
        ({"actions": None}, {}, "no actions in it"),
        ({"timeouts": None}, {}, "does not say where episodes were cut off"),
        ({"rewards": np.ones(5, np.float32)}, {}, "arrays of different lengths"),
        ({"actions": np.ones(6, np.float32)}, {}, "wrong actions; expected a matrix"),
        ({"observations": np.full((6, 2), np.nan, np.float32)}, {}, "are NaN or infinite"),
        ({"next_observations": np.zeros((6, 2), np.float32)}, {}, "starts elsewhere"),
        ({"actions": np.array([["a"]] * 6)}, {}, "wrong actions"),
        ({"actions": np.ones((6, 1), int)}, {}, r"floats, found array of shape \(3, 1\) of int"),
        ({"rewards": np.array(["a"] * 6)}, {}, "wrong rewards; expected numbers"),
        ({"timeouts": np.zeros(6, bool), "terminals": np.zeros(6, bool)}, {}, "no step ends an"),
        ({"rewards": np.array([None] * 6)}, {}, "damaged, or not an .npz file of plain numbers"),
        ({}, {"name": "ml10"}, "there is a family of that name"),
        ({}, {"name": "a/b"}, "name 'a/b': letters"),
        ({}, {"format": "parquet"}, "parquet cannot become a family of its own"),
        ({}, {"quality": "exprt"}, "unknown quality 'exprt'"),
        ({}, {"horizon": 0}, "--horizon: too short"),
        ({}, {"test": ("b",)}, "unknown task 'b'"),
        ({}, {"test": ("left",)}, "no training task is left"),
    ],
)
def test_what_is_refused(
    arrays: dict[str, Any], asked: dict[str, Any], told: str, tmp_path: Path
) -> None:
    folder = tmp_path / "sets"
    folder.mkdir()
    np.savez(folder / "left.npz", **flat(**arrays))
    with pytest.raises(MpdtError, match=told):
        brought(folder, **asked)
    assert not (tmp_path / "mine.h5").exists()


def test_two_tasks_are_not_one_for_their_spelling(tmp_path: Path) -> None:
    for name in ("rächts-expert", "rächts-random"):
        np.savez(tmp_path / f"{name}.npz", **flat())
    spelled = Asked(format="npz", name="mine")
    assert [task.name for task in read([tmp_path], spelled, "mine").header.tasks] == ["r_chts"]
    np.savez(tmp_path / "röchts-expert.npz", **flat())
    with pytest.raises(MpdtError, match=r"be named 'r_chts'.*'rächts' and 'röchts'"):
        read([tmp_path], spelled, "mine")


def test_breaks_tell_two_tasks_apart_and_those_of_a_quality_do_not(tmp_path: Path) -> None:
    asked = Asked(format="npz", name="mine")
    for name in ("a_b-expert", "a_b.random", "medium_a_b-v2"):
        np.savez(tmp_path / f"{name}.npz", **flat())
    assert [task.name for task in read([tmp_path], asked, "mine").header.tasks] == ["a-b"]
    np.savez(tmp_path / "a-b-expert.npz", **flat())
    with pytest.raises(MpdtError, match=r"two tasks would be named 'a-b'"):
        read([tmp_path], asked, "mine")


def test_two_sizes_and_no_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "sets/far"
    folder.mkdir(parents=True)
    words = ["import", "sets", "--from", "npz", "-o", "mine.h5"]
    assert main([*words, "--family-of", "mine"]) == 2
    assert "nothing to import as npz" in capsys.readouterr().err
    np.savez(folder / "a.npz", **flat())
    assert main([*words, "--test", "a"]) == 2
    assert "add --family-of NAME" in capsys.readouterr().err
    assert main([*words, "--family-of", "mine", "--task-from", "folder"]) == 0
    assert mpdt.open("mine.h5").tasks.names == ("far",)
    wide = np.zeros((6, 5), np.float32)
    np.savez(folder / "b.npz", **flat(observations=wide, next_observations=wide))
    assert main([*words[:-1], "other.h5", "--family-of", "mine"]) == 1
    assert "observations of another size than in the episodes before" in capsys.readouterr().err
