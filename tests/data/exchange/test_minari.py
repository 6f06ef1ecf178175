"""Minari out and in, judged by the real package: load, recover the environment, replay."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from mpdt.data.exchange import hdf5, minari
from mpdt.data.slices.cut import Cut, cut_file
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset
from mpdt.data.store.seal import seal

Make = Callable[..., Any]


@pytest.fixture
def exported(run: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    """Export a file to `out`, where the real package then looks for it."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "out"))

    def export(path: object, *words: str) -> Path:
        assert run("export", path, "--to", "minari", "-o", "out", *words) == 0
        return tmp_path / "out"

    return export


def test_minari_lists_loads_and_prints_every_set(collected: Path, exported: Make) -> None:
    import minari

    exported(collected)
    data = open_dataset(collected)
    wanted = {
        f"mpdt/cheetah_dir/{task}/{quality}-v1"
        for task in ("forward", "backward")
        for quality in ("random", "medium", "expert", "history")
    }
    assert set(minari.list_local_datasets(compatible_minari_version=True)) == wanted
    for name in wanted:
        _, _, task, quality = name.removesuffix("-v1").split("/")
        ids = data.select(task=task, quality=quality)
        found = minari.load_dataset(name)
        assert found.total_episodes == 4 and found.total_steps == 20
        for episode, i in zip(found, ids, strict=True):
            one = data.episode(i)
            assert "EpisodeData(id=" in repr(episode)
            np.testing.assert_array_equal(episode.observations, one.observations)
            np.testing.assert_array_equal(episode.actions, one.actions)
            np.testing.assert_array_equal(episode.rewards, one.rewards)
            np.testing.assert_array_equal(episode.truncations, one.truncations)
            assert episode.observations.dtype == np.float32
        assert found.action_space.shape == (6,) and found.observation_space.shape == (20,)
    assert minari.get_normalized_score(
        minari.load_dataset("mpdt/cheetah_dir/forward/expert-v1"),
        np.array([data.tasks.ref_random[0], data.tasks.ref_expert[0]]),
    ).tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("file", "name"),
    [("reach", "mpdt/ml10/reach/expert-v2"), ("cheetah", "mpdt/cheetah_dir/forward/random-v1")],
)
def test_an_episode_replays_in_the_recovered_environment(
    file: str, name: str, exported: Make, request: pytest.FixtureRequest
) -> None:
    import minari

    exported(request.getfixturevalue(file))
    found = minari.load_dataset(name)
    env = found.recover_environment()
    (start,) = found.storage.get_episode_metadata([1])
    episode = found[1]
    observation, _ = env.reset(seed=start["seed"], options=start["options"])
    np.testing.assert_array_equal(observation.astype(np.float32), episode.observations[0])
    for t, action in enumerate(episode.actions):
        observation, reward, terminated, truncated, info = env.step(action)
        np.testing.assert_array_equal(observation.astype(np.float32), episode.observations[t + 1])
        assert np.float32(reward) == episode.rewards[t]
        assert (terminated, truncated) == (episode.terminations[t], episode.truncations[t])
        if file == "reach":
            assert bool(info["success"]) == episode.infos["success"][t + 1]
    assert truncated
    env.close()


@pytest.mark.parametrize("file", ["collected", "reach"])
def test_out_and_in_again_is_the_same_data(
    file: str, exported: Make, imported: Make, request: pytest.FixtureRequest
) -> None:
    path = request.getfixturevalue(file)
    exported(path)
    back: Dataset = imported("out", "--from", "minari")
    data = open_dataset(path)
    assert back.content_hash == data.content_hash
    assert (back.version, back.spec) == (data.version, data.spec)
    assert repr(back.tasks.references) == repr(data.tasks.references)  # NaN


def test_a_slice_is_the_same_data_as_the_cut_file(
    collected: Path, exported: Make, imported: Make, tmp_path: Path
) -> None:
    exported(f"{collected}:expert")
    back: Dataset = imported("out", "--from", "minari")
    cut = cut_file(open_dataset(collected), Cut(quality="expert"), tmp_path / "expert.h5")
    assert (back.content_hash, back.parent) == (cut.content_hash, cut.parent)
    assert back.episodes.source is not None and cut.episodes.source is not None
    assert back.episodes.source.tolist() == cut.episodes.source.tolist()


def test_how_it_lies_on_the_disk(reach: Path, exported: Make) -> None:
    place = exported(reach) / "mpdt/ml10/reach/random-v2/data"
    metadata = json.loads((place / "metadata.json").read_text())
    assert metadata["minari_version"] == "0.5.0" and metadata["jpeg_encoding"] is False
    data = open_dataset(reach)
    assert metadata["ref_min_score"] == data.tasks.ref_random[0]
    assert metadata["ref_max_score"] == data.tasks.ref_expert[0]
    assert f"mujoco=={data.packages['mujoco']}" in metadata["requirements"]
    with h5py.File(place / "main_data.hdf5") as file:
        assert list(file) == ["episode_0", "episode_1"]
        for group in file.values():
            assert group["observations"].chunks is None and list(group["infos"]) == ["success"]
            assert group["infos/success"].shape == (13,)


def test_unknown_provenance_survives(
    tmp_path: Path, episode: Make, dump: Make, imported: Make, exported: Make, run: Make
) -> None:
    """Empty goal, no seed, no references, NaN levels, quality -1."""
    one = episode(3, sizes=(39, 4))
    one["observations"][:, 36:] = one["next_observations"][:, 36:] = 0
    dump([one], tmp_path / "ML1-pick-place-v2-0-expert.pkl")
    words = ("--from", "promptdt", "--family", "ml10", "--horizon", 3, "--quality", "unknown")
    first: Dataset = imported("ML1-pick-place-v2-0-expert.pkl", *words)
    folder = exported("imported.h5")
    place = folder / "mpdt/ml10/pick-place/unknown-v0/data"
    assert json.loads((place / "metadata.json").read_text())["ref_min_score"] is None
    with h5py.File(place / "main_data.hdf5") as file:
        assert "seed" not in file["episode_0"].attrs
    Path("imported.h5").unlink()
    assert imported("out", "--from", "minari").content_hash == first.content_hash


def test_a_task_name_with_a_dot(
    tmp_path: Path, episode: Make, dump: Make, imported: Make, exported: Make
) -> None:
    import minari

    dump([episode(3)], tmp_path / "cheetah_vel-2-expert.pkl")
    words = ("--from", "promptdt", "--family", "cheetah_vel", "--horizon", 3)
    first: Dataset = imported("cheetah_vel-2-expert.pkl", *words)
    exported("imported.h5")
    assert len(minari.load_dataset("mpdt/cheetah_vel/v0_225/expert-v0")) == 1
    Path("imported.h5").unlink()
    assert imported("out", "--from", "minari").tasks.names == first.tasks.names == ("v0.225",)


def test_changed_or_missing_sets_of_ours(
    collected: Path, exported: Make, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = exported(collected)
    (family,) = (folder / "mpdt").iterdir()
    words = ("import", "out", "--from", "minari", "-o", "x.h5")
    with h5py.File(family / "forward/medium-v1/data/main_data.hdf5", "r+") as file:
        file["episode_0/rewards"][0] += 1
    assert run(*words) == 1
    assert "not the episodes that were exported" in capsys.readouterr().err
    with h5py.File(family / "forward/medium-v1/data/main_data.hdf5", "r+") as file:
        del file["episode_0"].attrs["options/quality"]
    assert run(*words) == 1
    assert "options of an episode are wrong" in capsys.readouterr().err
    shutil.rmtree(family / "forward/medium-v1")
    assert run(*words) == 1
    assert "expected 32 episodes, found 28" in capsys.readouterr().err
    # What is left is data all the same, of unknown origin.
    rest = ("--family", "cheetah_dir", "--task", "backward", "--horizon", 5)
    assert (
        run("import", family / "backward/expert-v1", "--from", "minari", *rest, "-o", "x.h5") == 0
    )


def test_links_show_the_episodes_to_minari_and_are_not_followed_by_us(
    collected: Path, exported: Make, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    import minari

    exported(collected, "--link")
    data = open_dataset(collected)
    expert = minari.load_dataset("mpdt/cheetah_dir/forward/expert-v1")
    first = data.episode(int(data.select(task="forward", quality="expert")[0]))
    np.testing.assert_array_equal(next(iter(expert)).observations, first.observations)
    assert run("import", "out", "--from", "minari", "-o", "x.h5") == 1
    error = capsys.readouterr().err
    assert "observations is in another file" in error and "without --link" in error
    assert run("export", collected, "--to", "npz", "-o", "npz", "--link") == 2


def test_an_entry_point_is_ours_and_never_a_files(
    collected: Path, tmp_path: Path, exported: Make, imported: Make
) -> None:
    """`recover_environment` of the real package would call what stands there."""
    import minari

    path = tmp_path / "evil.h5"
    path.write_bytes(collected.read_bytes())
    evil = json.dumps({"entry_point": "os:system", "kwargs": {"command": "touch PWNED"}})
    with h5py.File(path, "r+") as file:
        file["tasks/env"][...] = evil
        seal(file)
    exported(path)
    found = minari.load_dataset("mpdt/cheetah_dir/forward/expert-v1")
    assert found.env_spec.entry_point == "mpdt.data.sim.gym:make"
    assert found.env_spec.kwargs == {"family": "cheetah_dir", "task": "forward", "horizon": 5}
    found.recover_environment().close()
    assert not Path("PWNED").exists()
    back = imported("out", "--from", "minari")
    assert {env["entry_point"] for env in back.tasks.envs} == {"mpdt.data.sim.gym:make"}


def test_links_that_show_other_rows_are_noticed(
    run: Callable[..., int], collected: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """A row off: what a virtual dataset of a wrong source shows, without an error of its own."""
    real = hdf5.linked

    def shifted(group: Any, name: str, source: Any, rows: slice) -> None:
        first = max(0, rows.start - 1)
        real(group, name, source, slice(first, first + rows.stop - rows.start))

    monkeypatch.setattr(hdf5, "linked", shifted)
    assert run("export", collected, "--to", "minari", "-o", "out", "--link") == 1
    assert "links do not show the episodes" in capsys.readouterr().err
    assert not Path("out").exists()


def test_minaris_own_writer_writes_the_same(reach: Path, exported: Make, tmp_path: Path) -> None:
    """The twin: its storage class, fed with the episodes of a set of ours, and read by itself."""
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    ours = MinariStorage.read(exported(reach) / "mpdt/ml10/reach/expert-v2/data")
    theirs = MinariStorage.new(
        tmp_path / "theirs", ours.observation_space, ours.action_space, jpeg_encoding=False
    )
    data = open_dataset(reach)
    ids = data.select(task="reach", quality="expert").tolist()
    starts = list(ours.get_episode_metadata(range(len(ids))))
    theirs.update_episodes(
        EpisodeBuffer(
            id=number, seed=start["seed"], options=start["options"],
            infos={"success": np.append(False, one.successes)},
            **{name: getattr(one, name) for name in minari.STEPS},
        )
        for number, (start, one) in enumerate(zip(starts, map(data.episode, ids), strict=True))
    )  # fmt: skip
    assert ours.total_episodes == theirs.total_episodes == len(ids) > 0
    for numbers in ([0], range(len(ids))):
        for one, other in zip(*(s.get_episodes(numbers) for s in (ours, theirs)), strict=True):
            assert one.keys() == other.keys()
            for name in minari.STEPS:
                np.testing.assert_array_equal(one[name], other[name])
                assert one[name].dtype == other[name].dtype
            np.testing.assert_array_equal(one["infos"]["success"], other["infos"]["success"])
    for one, other in zip(starts, theirs.get_episode_metadata(range(len(ids))), strict=True):
        assert repr(one) == repr(other)
    metadata = (s.read_raw_metadata(s.data_path) for s in (ours, theirs))
    mine, own = (dict(one) for one in metadata)
    told = set(own) - {
        "dataset_size",
        "jpeg_encoding",
    }  # theirs counts at every write, in other units
    assert {key: mine[key] for key in told & set(mine)} == {
        key: own[key] for key in told & set(mine)
    }
    assert told - set(mine) == set()
