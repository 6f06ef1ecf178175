"""Prompt-DT pickles in and out; numbers are those of `foreign_episode` in conftest."""

from __future__ import annotations

import io
import json
import pickle
import pickletools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mpdt.data.exchange import promptdt
from mpdt.data.exchange.foreign import natural
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset
from mpdt.seeding import UNKNOWN_SEED_KEY

Make = Callable[..., Any]
VEL = ("--from", "promptdt", "--family", "cheetah_vel", "--horizon", 3)


@pytest.fixture
def repository(tmp_path: Path, episode: Make, dump: Make) -> Path:
    """data/ and config/ of cheetah_vel, tasks 2 and 10."""
    data, config = tmp_path / "pdt/data/cheetah_vel", tmp_path / "pdt/config/cheetah_vel"
    both = [episode(3), episode(3, 1000.0)]
    dump(both, data / "cheetah_vel-10-expert.pkl")
    dump(both[:1], data / "cheetah_vel-10-prompt-expert.pkl")
    dump([episode(3, 2000.0)], data / "cheetah_vel-10-random.pkl")
    dump([episode(3, 3000.0)], data / "cheetah_vel-2-medium.pkl")
    dump([{"velocity": np.float64(0.22500000000000003)}], config / "config_cheetah_vel_task2.pkl")
    dump([{"velocity": np.float32(0.825)}], config / "config_cheetah_vel_task10.pkl")
    return tmp_path / "pdt"


def test_files_of_a_family_become_one_file(
    repository: Path, imported: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    data: Dataset = imported(repository, *VEL)
    assert data.tasks.names == ("v0.225", "v0.825") and data.tasks.roles.tolist() == [1, 0]
    # Ascending (task, quality); the prompt is the first expert episode, and not stored twice.
    columns = data.episodes
    assert columns.task.tolist() == [0, 1, 1, 1]
    assert columns.quality.tolist() == [1, 0, 2, 2]
    assert data.steps.observations[columns.obs_start, 0].tolist() == [3000, 2000, 0, 1000]
    assert "left out 1 episodes that are there already" in capsys.readouterr().err
    # T+1 observations: the last one is the last of next_observations.
    one = data.episode(2)
    np.testing.assert_array_equal(one.observations, np.arange(80).reshape(4, 20))
    assert one.rewards.tolist() == [1, 2, 3] and columns.returns.tolist() == [6.0] * 4
    # Row H-1 is a time limit, not the end of the task.
    assert one.truncations.tolist() == [False, False, True] and not one.terminations.any()
    assert [data.goals.of(int(g)).tolist() for g in columns.goal] == [
        [0.22500000000000003], *[[float(np.float32(0.825))]] * 3,
    ]  # fmt: skip


def test_what_the_files_do_not_say_is_unknown(repository: Path, imported: Make) -> None:
    data: Dataset = imported(repository, *VEL)
    columns = data.episodes
    assert (columns.progress == -1).all()
    assert (columns.seed_key == np.array(UNKNOWN_SEED_KEY)).all()
    assert not data.policies.hashes.any() and data.policies.names == ("unknown", "unknown")
    assert np.isnan(data.tasks.ref_random).all() and np.isnan(data.tasks.ref_expert).all()
    assert data.license == "NOASSERTION" and "mujoco" not in data.packages
    assert set(data.slices) == {"random", "medium", "expert", "train", "test"}
    assert data.stats_info is not None and data.stats_info.tasks_seen == (1,)


def test_the_spec_says_where_it_came_from(repository: Path, imported: Make) -> None:
    spec = imported(repository, *VEL).spec
    assert spec["horizon"] == 3 and spec["import"]["from"] == "promptdt"
    names = [source["name"] for source in spec["import"]["sources"]]
    assert names == [
        "cheetah_vel-2-medium.pkl", "cheetah_vel-10-random.pkl", "cheetah_vel-10-expert.pkl",
        "cheetah_vel-10-prompt-expert.pkl",
    ]  # fmt: skip
    last = spec["import"]["sources"][-1]
    assert last["duplicates_left_out"] == 1 and last["episodes"] == 0
    assert len(last["sha256"]) == 64 and str(repository) not in str(spec)


def test_a_fall_of_the_ant_is_told_from_the_time_limit(
    tmp_path: Path, episode: Make, dump: Make, imported: Make
) -> None:
    file = tmp_path / "ant_dir-6-medium.pkl"
    dump([episode(2, sizes=(27, 8)), episode(3, 9.0, sizes=(27, 8))], file)
    data: Dataset = imported(file, "--from", "promptdt", "--family", "ant_dir", "--horizon", 3)
    assert data.steps.terminations.tolist() == [False, True, False, False, False]
    assert data.steps.truncations.tolist() == [False, False, False, False, True]
    assert data.goals.of(0).tolist() == [0.24543954]  # no config: the family's own goal


def test_dones_and_one_goal_of_fifty(
    tmp_path: Path, episode: Make, dump: Make, imported: Make
) -> None:
    one = episode(3, sizes=(39, 4))
    one["observations"][:, 36:] = one["next_observations"][:, 36:] = 0
    one["dones"] = one.pop("terminals")
    dump([one], tmp_path / "ML1-pick-place-v2-41-prompt-expert.pkl")
    words = ("--from", "promptdt", "--family", "ml10", "--horizon", 3)
    data: Dataset = imported(tmp_path / "ML1-pick-place-v2-41-prompt-expert.pkl", *words)
    assert data.tasks.names == ("pick-place",) and data.goals.of(0).shape == (0,)
    assert data.steps.successes is None


def changed(one: Any, key: str, value: Any) -> Any:
    return one | {key: value}


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda e: 5, "not a dict of arrays"),
        (lambda e: {"rewards": e["rewards"]}, "no observations, next_observations, actions, dones"),
        (lambda e: changed(e, "rewards", e["rewards"][:2]), "wrong observations"),
        (lambda e: changed(e, "rewards", e["rewards"].astype(int)), "an array of floats"),
        (lambda e: changed(e, "rewards", e["rewards"] * np.nan), "3 numbers in rewards are NaN"),
        (lambda e: changed(e, "rewards", np.ones((3, 2), np.float32)), "wrong rewards"),
        (lambda e: changed(e, "observations", [[1.0]]), "expected a matrix"),
        (lambda e: changed(e, "observations", e["observations"] * 1e30), "starts elsewhere"),
        (lambda e: changed(e, "next_observations", e["observations"]), "the step after step 0"),
        (lambda e: changed(e, "actions", e["actions"][:, :4]), "4 columns fit ml10"),
        (lambda e: changed(e, "actions", e["actions"] * 8), "18 numbers in actions outside"),
        (lambda e: changed(e, "actions", e["actions"] * np.inf), "NaN or infinite"),
        (lambda e: changed(e, "terminals", ~e["terminals"]), "rows [0, 1]"),
        (lambda e: changed(e, "terminals", e["terminals"] & False), "found rows []"),
        (lambda e: changed(e, "terminals", e["terminals"] * 2), "flags, 0 or 1"),
        (lambda e: changed(e, "actions", [[0.0] * 6] * 3), "an array of floats, found list"),
        (lambda e: {k: v[1:] for k, v in e.items()}, "has no end but its time limit"),
        (lambda e: {k: np.concatenate([v, v]) for k, v in e.items()}, "starts elsewhere"),
        (lambda e: {k: v[:0] for k, v in e.items()}, "a matrix of T >= 1 rows"),
    ],
)  # fmt: skip
def test_wrong_numbers_name_file_and_episode(
    tmp_path: Path, episode: Make, dump: Make, run: Make, capsys: pytest.CaptureFixture[str],
    change: Callable[[Any], Any], text: str,
) -> None:  # fmt: skip
    dump([episode(3, 50.0), change(episode(3))], tmp_path / "cheetah_vel-0-expert.pkl")
    assert run("import", "cheetah_vel-0-expert.pkl", *VEL, "-o", "x.h5") == 1
    error = capsys.readouterr().err
    assert text in error and "cheetah_vel-0-expert.pkl: episode 1" in error
    assert not list(tmp_path.glob("*.h5*"))


@pytest.mark.parametrize(
    ("name", "value", "code", "text"),
    [
        ("cheetah_vel-0-expert.pkl", {"a": 1}, 1, "not a list of episodes; found dict"),
        ("cheetah_vel-0-expert.pkl", [], 1, "a file without episodes"),
        ("cheetah_vel-40-expert.pkl", [], 1, "no task 40 in cheetah_vel"),
        ("ant_dir-0-expert.pkl", [], 1, "--family ant_dir"),
        ("other.pkl", [], 2, "other.pkl: not named <env>-<i>-<quality>.pkl"),
    ],
)  # fmt: skip
def test_wrong_files(
    tmp_path: Path, dump: Make, run: Make, capsys: pytest.CaptureFixture[str],
    name: str, value: Any, code: int, text: str,
) -> None:  # fmt: skip
    dump(value, tmp_path / name)
    assert run("import", name, *VEL, "-o", "x.h5") == code
    assert text in capsys.readouterr().err


@pytest.mark.parametrize(
    ("config", "text"),
    [
        ([{"velocity": 0.3}], "another goal than the family's; expected 0.225, found 0.3"),
        ([{"direction": 1.0}], "not a goal of cheetah_vel"),
        ({}, "not a goal of cheetah_vel"),
    ],
)
def test_a_config_has_to_be_the_familys(
    repository: Path, dump: Make, run: Make, capsys: pytest.CaptureFixture[str],
    config: Any, text: str,
) -> None:  # fmt: skip
    dump(config, repository / "config/cheetah_vel/config_cheetah_vel_task2.pkl")
    assert run("import", repository, *VEL, "-o", "x.h5") == 1
    assert text in capsys.readouterr().err


def test_nothing_is_replaced_and_a_family_is_needed(
    repository: Path, imported: Make, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    imported(repository, *VEL)
    assert run("import", repository, *VEL, "-o", "imported.h5") == 1
    assert "an import would replace another file" in capsys.readouterr().err
    assert run("import", repository, "--from", "promptdt", "-o", "x.h5") == 2
    assert run("import", repository, "--from", "promptdb", "-o", "x.h5") == 2
    assert "did you mean 'promptdt'" in capsys.readouterr().err
    assert run("import", repository, *VEL, "--hide-goal", "-o", "x.h5") == 2


def test_clipping_is_asked_for_and_recorded(
    tmp_path: Path, episode: Make, dump: Make, imported: Make
) -> None:
    one = episode(3)
    one["actions"][1] = [4.0, -2.0, 1.0, 0.5, 0.0, -1.0]
    dump([episode(3, 9.0), one], tmp_path / "cheetah_vel-0-expert.pkl")
    data: Dataset = imported(tmp_path, *VEL, "--clip-actions", "--quality", "unknown")
    assert data.episode(1).actions[1].tolist() == [1.0, -1.0, 1.0, 0.5, 0.0, -1.0]
    assert data.spec["import"]["clip_actions"] is True
    (source,) = data.spec["import"]["sources"]
    assert source["clipped"] == {"episodes": 1, "numbers": 2, "largest": 4.0}
    assert source["quality"] == "unknown" and (data.episodes.quality == -1).all()


# ---- out ----


class IndependentReader(pickle.Unpickler):
    """What someone with NumPy 1 sees: only names that NumPy 1 has."""

    def find_class(self, module: str, name: str) -> Any:
        assert (module, name) in {
            ("numpy.core.multiarray", "_reconstruct"), ("numpy.core.multiarray", "scalar"),
            ("numpy", "ndarray"), ("numpy", "dtype"),
        }  # fmt: skip
        return super().find_class(module, name)


def test_an_export_reads_back_elsewhere(collected: Path, run: Make) -> None:
    assert run("export", collected, "--to", "promptdt", "-o", "out") == 0
    data = open_dataset(collected)
    files = sorted(path.name for path in Path("out/data/cheetah_dir").iterdir())
    modes = ("expert", "history", "medium", "random")
    assert files == sorted(
        f"cheetah_dir-{i}-{prompt}{mode}.pkl"
        for i in (0, 1) for prompt in ("", "prompt-") for mode in modes
    )  # fmt: skip
    split = Path("out/config/cheetah_dir/cheetah_dir_2.json")
    assert json.loads(split.read_text()) == {
        "env": "cheetah_dir", "total_tasks": 2, "train_tasks": [0, 1], "test_tasks": [0, 1],
    }  # fmt: skip
    for task in (0, 1):
        goal = Path(f"out/config/cheetah_dir/config_cheetah_dir_task{task}.pkl").read_bytes()
        (config,) = IndependentReader(io.BytesIO(goal)).load()
        assert config == {"direction": (1.0, -1.0)[task]}
        content = Path(f"out/data/cheetah_dir/cheetah_dir-{task}-expert.pkl").read_bytes()
        assert content[:2] == b"\x80\x04" and b"numpy._core" not in content
        assert {op.name for op, _, _ in pickletools.genops(content)} <= {
            op.name for op in pickletools.opcodes if op.proto <= 4
        }
        episodes = IndependentReader(io.BytesIO(content)).load()
        ids = data.select(task=task, quality="expert")
        assert len(episodes) == len(ids) == 4
        for one, wanted in zip(episodes, map(data.episode, ids), strict=True):
            assert [type(array) for array in one.values()] == [np.ndarray] * 5
            np.testing.assert_array_equal(one["observations"], wanted.observations[:-1])
            np.testing.assert_array_equal(one["next_observations"], wanted.observations[1:])
            np.testing.assert_array_equal(one["actions"], wanted.actions)
            np.testing.assert_array_equal(one["rewards"], wanted.rewards[:, None])
            assert one["terminals"].tolist() == [[False]] * 4 + [[True]]
            assert {array.dtype.str for array in one.values()} == {"<f4", "|b1"}


def test_the_split_is_that_of_the_file(reach: Path, run: Make) -> None:
    """Named after all tasks of the file, with the exported ones alone; goals are in no file."""
    data = open_dataset(reach)
    assert run("export", reach, "--to", "promptdt", "-o", "out") == 0
    (split,) = Path("out/config").glob("*/*")
    assert split.name == f"ml10_{len(data.tasks.names)}.json"
    roles = dict(
        zip(map(int, np.unique(data.episodes.task)), data.tasks.roles.tolist(), strict=True)
    )
    said = json.loads(split.read_text())
    assert said["train_tasks"] == [i for i, role in roles.items() if role in (0, 2)]
    assert said["test_tasks"] == [i for i, role in roles.items() if role in (1, 2)]


def test_out_and_in_again_keeps_every_step(
    collected: Path, run: Make, imported: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("export", f"{collected}:medium", "--to", "promptdt", "-o", "out") == 0
    words = ("--from", "promptdt", "--family", "cheetah_dir", "--horizon", 5)
    back: Dataset = imported("out", *words)
    assert "not of this format" not in capsys.readouterr().err, "not even the split"
    data = open_dataset(collected)
    ids = data.select(slice="medium")
    assert back.num_episodes == len(ids) == 8
    for one, i in zip(map(back.episode, range(8)), ids, strict=True):
        wanted = data.episode(i)
        np.testing.assert_array_equal(one.observations, wanted.observations)
        np.testing.assert_array_equal(one.truncations, wanted.truncations)
        assert (one.task, one.quality, one.goal) == (wanted.task, wanted.quality, wanted.goal)


def test_an_export_appears_whole_or_not_at_all(
    collected: Path, run: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    words = ("export", collected, "--to", "promptdt", "-o", "out")
    seen: list[list[str]] = []

    def full(value: Any, path: Path) -> None:
        seen.append([path.name for path in tmp_path.glob("[!.]*")])
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("mpdt.data.exchange.promptdt._dump", full)
        assert run(*words) == 1
    assert "the disk is full" in capsys.readouterr().err
    assert seen == [[]] and not list(tmp_path.iterdir())
    (tmp_path / "out.tmp").mkdir()  # somebody's own
    assert run(*words) == 0
    assert run(*words) == 1
    assert "an export would replace something" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "out.tmp"]


def test_numbers_in_names_count_as_numbers() -> None:
    """The order of the episodes in the new file is that of the names."""
    names = ["x-10.pkl", "x-9-b.pkl", "x-9.pkl", "x-2.pkl"]
    assert sorted(names, key=natural) == ["x-2.pkl", "x-9-b.pkl", "x-9.pkl", "x-10.pkl"]


def test_prompts_are_the_first_five_episodes(
    collected: Path, run: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three, so that the four there are suffice."""
    assert promptdt.NUM_PROMPTS == 5
    monkeypatch.setattr(promptdt, "NUM_PROMPTS", 3)
    assert run("export", collected, "--to", "promptdt", "-o", "out") == 0
    folder = Path("out/data/cheetah_dir")
    whole, prompts = (
        IndependentReader(io.BytesIO((folder / name).read_bytes())).load()
        for name in ("cheetah_dir-0-expert.pkl", "cheetah_dir-0-prompt-expert.pkl")
    )
    assert (len(whole), len(prompts)) == (4, 3)
    np.testing.assert_array_equal(prompts[2]["observations"], whole[2]["observations"])
