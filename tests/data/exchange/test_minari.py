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

from mpdt.data.slices.cut import Cut, cut_file
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset

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


@pytest.mark.parametrize("words", [(), ("--link",)])
@pytest.mark.parametrize("file", ["collected", "reach"])
def test_out_and_in_again_is_the_same_data(
    file: str, words: tuple[str, ...], exported: Make, imported: Make,
    request: pytest.FixtureRequest,
) -> None:  # fmt: skip
    path = request.getfixturevalue(file)
    exported(path, *words)
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


# ---- sets of others ----


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A set of reach as minari's own functions write it: float64, chunked."""
    import minari
    from gymnasium import spaces
    from minari.data_collector import EpisodeBuffer

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "foreign"))
        buffers = []
        for first in (0.0, 100.0):
            rows = first + np.arange(4 * 39, dtype=np.float64).reshape(4, 39)
            rows[:, 36:] = 0
            buffers.append(
                EpisodeBuffer(
                    observations=rows, actions=np.full((3, 4), 0.5), rewards=[1.0, 2.0, 3.0],
                    terminations=[False] * 3, truncations=[False, False, True],
                    infos={"success": np.array([False, False, True, False])},
                )
            )  # fmt: skip
        patch.setattr("warnings.warn", lambda *args: None)  # about an eval_env
        minari.create_dataset_from_buffers(
            "other/reach-v0", buffers, action_space=spaces.Box(-1, 1, (4,)),
            observation_space=spaces.Box(-np.inf, np.inf, (39,)), algorithm_name="x",
            author="x", author_email="x", code_permalink="x", description="x",
        )  # fmt: skip
    return tmp_path / "foreign"


FOREIGN = ("--from", "minari", "--family", "ml10", "--task", "reach", "--horizon", 3)


def test_a_set_of_others(foreign: Path, imported: Make) -> None:
    data: Dataset = imported(foreign, *FOREIGN, "--quality", "medium")
    assert data.tasks.names == ("reach",) and data.episodes.quality.tolist() == [1, 1]
    assert data.episode(0).observations[1, :3].tolist() == [39, 40, 41]
    assert data.steps.successes is not None
    assert data.steps.successes.tolist() == [False, True, False] * 2
    assert data.steps.truncations.tolist() == [False, False, True] * 2
    assert data.spec["import"]["sources"][0]["name"] == "other/reach-v0"
    assert (data.episodes.progress == -1).all()


def changed(name: str, value: Any) -> Callable[[h5py.Group], None]:
    def change(group: h5py.Group) -> None:
        del group[name]
        group[name] = value

    return change


def in_parts(group: h5py.Group) -> None:
    del group["observations"]
    group["observations/achieved_goal"] = np.zeros((4, 39))


def linked_away(group: h5py.Group) -> None:
    del group["rewards"]
    group["rewards"] = h5py.ExternalLink("secret.h5", "/x")


def stored_away(group: h5py.Group) -> None:
    del group["rewards"]
    Path("secret").write_bytes(bytes(12))
    group.create_dataset("rewards", (3,), "<f4", external=[("secret", 0, 12)])


def source_gone(group: h5py.Group) -> None:
    del group["rewards"]
    layout = h5py.VirtualLayout((3,), "<f4")
    layout[:] = h5py.VirtualSource("gone.h5", "x", (3,), "<f4")
    group.create_virtual_dataset("rewards", layout)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (changed("rewards", np.full(3, np.nan)), "3 numbers in rewards are NaN"),
        (changed("rewards", np.zeros(2)), "wrong observations"),
        (changed("rewards", np.zeros(3, int)), "an array of floats"),
        (changed("rewards", np.array([b"x"] * 3)), "rewards is no array of numbers"),
        (changed("actions", np.full((3, 4), 2.0)), "12 numbers in actions outside the bounds"),
        (changed("observations", np.zeros((3, 39))), "expected shape (4, 39)"),
        (changed("observations", np.ones((4, 39))), "show the goal"),
        (changed("truncations", np.zeros(3, bool)), "found rows []"),
        (changed("terminations", np.array([0, 1, 0], bool)), "found rows [1, 2]"),
        (in_parts, "observations is no array of numbers; found a group"),
        (lambda group: group.__delitem__("actions"), "no actions"),
        (linked_away, "rewards is in another file; found secret.h5"),
        (stored_away, "rewards is in another file"),
        (source_gone, "rewards is a link to a file that is gone; found gone.h5"),
    ],
)
def test_wrong_sets_of_others(
    foreign: Path, run: Make, capsys: pytest.CaptureFixture[str],
    change: Callable[[h5py.Group], None], text: str,
) -> None:  # fmt: skip
    file = foreign / "other/reach-v0/data/main_data.hdf5"
    with h5py.File(file, "r+") as opened:
        change(opened["episode_1"])
    assert run("import", foreign, *FOREIGN, "-o", "x.h5") == 1
    error = capsys.readouterr().err
    assert text in error and "main_data.hdf5: episode 1" in error


def test_metadata_that_is_none(
    foreign: Path, run: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = foreign / "other/reach-v0/data/metadata.json"
    metadata = json.loads(file.read_text())
    cases: list[tuple[object, str]] = [
        (metadata | {"total_episodes": 3}, "expected 3, found 2"),
        (metadata | {"data_format": "arrow"}, "expected data_format hdf5, found arrow"),
        (metadata | {"mpdt": {}}, "another storage format"),
        ([], "not the metadata of a Minari dataset"),
    ]
    for content, text in cases:
        file.write_text(json.dumps(content))
        assert run("import", foreign, *FOREIGN, "-o", "x.h5") == 1
        assert text in capsys.readouterr().err
    file.write_text(json.dumps(metadata))
    (tmp_path / "empty").mkdir()
    assert run("import", "empty", *FOREIGN, "-o", "x.h5") == 2
    assert run("import", foreign, *FOREIGN[:4], "-o", "x.h5") == 2
    assert "of which task?" in capsys.readouterr().err
    assert run("import", foreign, "--from", "minari", "-o", "x.h5") == 2


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


def test_a_link_to_a_file_that_is_gone(
    collected: Path, exported: Make, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(collected, "moved.h5")
    exported("moved.h5", "--link")
    Path("moved.h5").unlink()
    assert run("import", "out", "--from", "minari", "-o", "x.h5") == 1
    error = capsys.readouterr().err
    assert "is a link to a file that is gone" in error and "moved.h5" in error
    assert run("export", collected, "--to", "npz", "-o", "npz", "--link") == 2
