"""LeRobot trees in: our own export, trees of both versions, and what is wrong with others."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset
from mpdt.data.verify.verify import verify

Make = Callable[..., Any]
ML10 = ("--from", "lerobot", "--family", "ml10", "--hide-goal")
LENGTHS = (4, 3)


def tree(folder: Path, version: str = "v2.1", **changes: Any) -> Path:
    """Two episodes of reach and one of push with pictures, a hand state and the whole state."""
    texts = changes.get("texts", ["reach-v3", "push-v2"])
    features = {
        "observation.image": {"dtype": "video", "shape": [3, 8, 8]},
        "observation.state": {"dtype": "float32", "shape": [4]},
        "observation.environment_state": {"dtype": "float32", "shape": [39]},
        "action": {"dtype": "float32", "shape": [4]},
        **{name: {"dtype": kind, "shape": [1]} for name, kind in (
            ("next.reward", "float32"), ("next.success", "bool"), ("episode_index", "int64"),
            ("task_index", "int64"))},
    } | changes.get("features", {})  # fmt: skip
    meta, data = folder / "meta", folder / "data/chunk-000"
    meta.mkdir(parents=True)
    data.mkdir(parents=True)
    info = {"codebase_version": changes.get("said", version), "features": features,
            "fps": changes.get("fps", 0)}  # fmt: skip
    (meta / "info.json").write_text(json.dumps(info))
    tables = [steps(0, 0, 4), steps(1, 1, 3), steps(2, 0, 2)]
    if version == "v3.0":
        rows = {"task_index": [0, 1], "__index_level_0__": texts}
        pq.write_table(pa.table(rows), meta / "tasks.parquet")
        pq.write_table(pa.concat_tables(tables), data / "file-000.parquet")
    else:
        lines = [json.dumps({"task_index": i, "task": text}) for i, text in enumerate(texts)]
        (meta / "tasks.jsonl").write_text("\n".join(lines) + "\n")
        for number, table in enumerate(tables):
            pq.write_table(table, data / f"episode_{number:06d}.parquet")
    return folder


def steps(episode: int, task: int, count: int) -> Any:
    """Vectors as lists of any length, which is how `datasets` writes them."""
    first = 100.0 * episode
    vector = pa.list_(pa.float32())
    states = np.arange(count * 39, dtype=np.float32).reshape(count, 39) + first
    return pa.table({
        "observation.state": pa.array(states[:, :4].tolist(), vector),
        "observation.environment_state": pa.array(states.tolist(), vector),
        "action": pa.array((np.full((count, 4), 0.1) * np.arange(count)[:, None]).tolist(), vector),
        "next.reward": pa.array(np.arange(count) + first, pa.float32()),
        "next.success": pa.array(np.arange(count) > 0),
        "episode_index": pa.array([episode] * count), "task_index": pa.array([task] * count),
    })  # fmt: skip


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_a_tree_of_others(
    tmp_path: Path, imported: Make, capsys: pytest.CaptureFixture[str], version: str
) -> None:
    data: Dataset = imported(tree(tmp_path / "theirs", version), *ML10)
    said = capsys.readouterr().err
    assert "left out the last step of each of 3 episodes" in said
    assert "left out observation.image" in said and "references stay unknown" in said
    assert [data.tasks.names[row] for row in data.episodes.task] == ["reach", "reach", "push"]
    assert data.episodes.length.tolist() == [3, 1, 2] and (data.episodes.quality == -1).all()
    one = data.episode(0)
    # 39 numbers are the family's; the hand's four alone are not. The goal's columns are hidden.
    np.testing.assert_array_equal(one.observations[:, :36], np.arange(156).reshape(4, 39)[:, :36])
    assert one.rewards.tolist() == [0, 1, 2] and one.successes.tolist() == [False, True, True]
    np.testing.assert_allclose(one.actions[:, 0], [0, 0.1, 0.2], rtol=1e-6)
    assert one.truncations.tolist() == [False, False, True] and not one.terminations.any()
    assert "horizon" not in data.spec


def test_our_own_tree_loses_its_last_steps_only(reach: Path, imported: Make, run: Make) -> None:
    assert run("export", reach, "--to", "lerobot", "-o", "out") == 0
    data, before = imported("out", *ML10[:4]), open_dataset(reach)
    assert data.num_episodes == before.num_episodes == 4
    for i in range(4):
        one, own = data.episode(i), before.episode(i)
        np.testing.assert_array_equal(one.observations, own.observations[:-1])
        np.testing.assert_array_equal(one.actions, own.actions[:-1])
        np.testing.assert_array_equal(one.rewards, own.rewards[:-1])
        np.testing.assert_array_equal(one.successes, own.successes[:-1])


def test_a_tree_that_lost_something_is_no_tree(
    reach: Path, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    """What lies to both sides of a lost row is no step."""
    assert run("export", reach, "--to", "lerobot", "-o", "out") == 0
    path = Path("out/data/chunk-000/file-000.parquet")
    table = pq.read_table(path)
    episodes, count = table["episode_index"].to_numpy(), table.num_rows
    for keep, said in (
        ([*range(3), *range(4, count)], "rows are missing or doubled"),
        (np.flatnonzero(episodes != 2), "number of episodes in its metadata; expected 4, found 3"),
        (range(count - 5), "number of rows in its metadata"),
        ([], "number of episodes in its metadata; expected 4, found 0"),
    ):
        pq.write_table(table.take(pa.array(list(keep), pa.int64())), path)
        capsys.readouterr()
        assert run("import", "out", *ML10, "-o", "x.h5") == 1
        assert said in capsys.readouterr().err and not Path("x.h5").exists()


def _text(name: str, content: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_text(content) and None


def _steps(change: Callable[[Any], Any]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        path = folder / "data/chunk-000/file-000.parquet"
        pq.write_table(change(pq.read_table(path)), path)

    return apply


def _column(name: str, values: Any) -> Callable[[Path], None]:
    return _steps(lambda t: t.set_column(t.column_names.index(name), name, pa.array(values)))


def _many(folder: Path) -> None:
    """Ten million equal numbers are a few kilobytes."""
    table = pa.table({name: pa.array(np.zeros(10_000_000, np.int64))
                      for name in ("episode_index", "task_index")})  # fmt: skip
    pq.write_table(table, folder / "data/chunk-000/file-000.parquet", compression="zstd")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_text("meta/info.json", "{"), "info.json"),
        (_text("meta/info.json", '{"codebase_version": "v1.6"}'), "known version"),
        (_text("meta/info.json", '{"codebase_version": "v3.0", "features": [1]}'), "info.json"),
        (_text("meta/tasks.parquet", "no table"), "tasks.parquet"),
        (_text("data/chunk-000/file-000.parquet", "no table"), "file-000.parquet"),
        (_steps(lambda t: t.drop_columns("action")), "file-000.parquet"),
        (_column("task_index", [0, 0, 1, 1, 1, 1, 1, 0, 0]), "several tasks"),
        (_column("episode_index", [0, 0, 1, 1, 1, 1, 1, 0, 0]), "do not lie together"),
        (_column("task_index", [7] * 9), "task_index 7 has no text"),
        (_column("next.reward", [None] + [0.0] * 8), "empty cells"),
        (_column("action", [[0.0] * 4] * 8 + [[0.0] * 3]), "several lengths"),
        (_column("action", [[9.0] * 4] * 9), "outside the bounds"),
        (_many, "more than a file of its size can hold"),
    ],
)
def test_what_is_wrong_is_one_error_with_its_place(
    tmp_path: Path, run: Make, capsys: pytest.CaptureFixture[str], change: Make, said: str
) -> None:
    folder = tree(tmp_path / "theirs", "v3.0")
    change(folder)
    assert run("import", folder, *ML10, "-o", "x.h5") in (1, 2)
    error = capsys.readouterr().err
    assert said in error and str(folder) in error and error.count("error:") == 1
    assert not Path("x.h5").exists()


def test_words_that_do_not_fit(
    tmp_path: Path, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*words: object, code: int = 2) -> str:
        assert run("import", *words, "-o", "x.h5") == code
        return capsys.readouterr().err

    folder = tree(tmp_path / "one", texts=["raech-v3", "push-v2"])
    assert "ml10 has no task raech-v3" in (error := fails(folder, *ML10)) and "reach" in error
    words: tuple[object, ...] = ("--task", "reach", "--quality", "medium")
    assert run("import", folder, *ML10, *words, "-o", "y.h5") == 0
    assert open_dataset("y.h5").episodes.quality.tolist() == [1] * 3
    error = fails(folder, "--from", "lerobot", "--family", "cheetah_vel", code=1)
    assert "no action of 6 numbers" in error
    (tmp_path / "empty").mkdir()
    assert "a folder with meta/info.json" in fails(tmp_path / "empty", *ML10)
    assert "--family" in fails(folder, "--from", "lerobot")


# ---- as a family of their own ----

OWN = ("--from", "lerobot", "--family-of", "theirs")


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_a_tree_as_a_family_of_its_own(
    tmp_path: Path, imported: Make, capsys: pytest.CaptureFixture[str], version: str
) -> None:
    data: Dataset = imported(tree(tmp_path / "mt-expert", version), *OWN, "--test", "push-v2")
    said = capsys.readouterr().err
    assert (
        "left out the last step of each of 3 episodes" in said and "the only success of 1\n" in said
    )
    assert "left out observation.image, observation.environment_state of 39 numbers" in said
    family = data.contract()
    assert [(task.name, task.role) for task in family.tasks] == [
        ("push-v2", "test"), ("reach-v3", "train")
    ]  # fmt: skip
    # The folder's name says how good they are.
    assert data.episodes.length.tolist() == [2, 3, 1] and (data.episodes.quality == 2).all()
    assert (family.observation_size, family.action_size, family.horizon) == (4, 4, 3)
    assert family.has_success and not family.ends_early and not family.simulates
    one = data.episode(1)
    first = [[0, 1, 2, 3], [39, 40, 41, 42], [78, 79, 80, 81], [117, 118, 119, 120]]
    assert one.observations.tolist() == first and one.rewards.tolist() == [0, 1, 2]
    assert one.truncations.tolist() == [False, False, True] and "horizon" not in data.spec
    assert [ref["expert"].mean for ref in data.tasks.references] == [
        100 + 101,
        (0 + 1 + 2 + 200) / 2,
    ]
    assert data.spec["import"]["sources"][0]["states"] == ["observation.state"]
    outcomes = {one.outcome.value for one in verify(data.path).findings}
    assert "FAIL" not in outcomes


def test_trees_that_disagree(tmp_path: Path, imported: Make) -> None:
    """In their seconds per step, so one is written; in the words before a task, so they stay."""
    for fps in (10, 20):
        tree(tmp_path / f"theirs/{fps}", fps=fps, texts=["ml10: reach", "push"])
    data = imported(tmp_path / "theirs", *OWN)
    assert data.contract().step_s == 1.0 and data.tasks.names == ("ml10_reach", "push")


@pytest.mark.parametrize(
    ("states", "width", "first"),
    [
        ("observation.environment_state", 39, [0, 1, 2, 3, 4]),
        ("observation.state,observation.environment_state", 43, [0, 1, 2, 3, 0]),
    ],
)
def test_which_columns_are_the_state(
    tmp_path: Path, imported: Make, states: str, width: int, first: list[int]
) -> None:
    data = imported(tree(tmp_path / "theirs", "v3.0"), *OWN, "--states", states)
    assert data.observation_size == width
    assert data.episode(1).observations[0, :5].tolist() == first


def test_our_own_tree_as_a_family_keeps_names_and_seconds(
    cheetah: Path, imported: Make, run: Make
) -> None:
    assert run("export", cheetah, "--to", "lerobot", "-o", "out") == 0
    data, before = imported("out", *OWN), open_dataset(cheetah)
    family, known = data.contract(), before.contract()
    assert data.tasks.names == ("forward",) and family.columns == known.columns
    assert family.step_s == known.step_s == 0.05 and data.spec["horizon"] == 11
    for i in range(2):
        one, own = data.episode(i), before.episode(i)
        np.testing.assert_array_equal(one.observations, own.observations[:-1])
        np.testing.assert_array_equal(one.actions, own.actions[:-1])
        np.testing.assert_array_equal(one.rewards, own.rewards[:-1])


def _added(name: str, values: list[Any]) -> Callable[[Path], None]:
    """A column of one value a row, in features and data."""

    def apply(folder: Path) -> None:
        info = json.loads((folder / "meta/info.json").read_text())
        info["features"][name] = {"dtype": "string", "shape": [1]}
        (folder / "meta/info.json").write_text(json.dumps(info))
        _steps(lambda t: t.append_column(name, pa.array(values)))(folder)

    return apply


@pytest.mark.parametrize(
    ("values", "names"),
    [
        ([0.25] * 4 + [-1.0] * 5, ("goal_0.25", "goal_-1")),
        ([1.00000001] * 4 + [1.00000002] * 5, ("goal_1.00000001", "goal_1.00000002")),
        ([np.float32(0.1)] * 4 + [np.float32(0.3)] * 5, ("goal_0.1", "goal_0.3")),
        ([2**60] * 4 + [2**60 + 1] * 5, (f"goal_{2**60}", f"goal_{2**60 + 1}")),
        ([7_000_001] * 4 + [7_000_000] * 5, ("goal_7000000", "goal_7000001")),
        (["go left, now"] * 7 + ["go"] * 2, ("go", "go_left_now")),
        (["a " * 80 + "b"] * 7 + ["a " * 80 + "c"] * 2,
         ("a_" * 45 + "a-0609d2a7", "a_" * 45 + "a-ad0b0763")),
    ],
)  # fmt: skip
def test_a_column_names_the_tasks(
    tmp_path: Path, imported: Make, values: list[Any], names: tuple[str, str]
) -> None:
    folder = tree(tmp_path / "theirs", "v3.0")
    _added("my.goal", values)(folder)
    data = imported(folder, *OWN, "--task-from", "my.goal")
    assert data.tasks.names == names


def test_an_only_success_that_is_left_out_is_told(
    tmp_path: Path, imported: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tree(tmp_path / "theirs", "v3.0")
    _column("next.success", [False] * 3 + [True] * 2 + [False] * 3 + [True])(folder)
    imported(folder, *OWN)
    said = capsys.readouterr().err
    assert "after it; with it the only success of 2" in said
    assert "none are on record for a family of one's own" in said and "datasets.yaml" not in said


@pytest.mark.parametrize(
    ("change", "words", "said"),
    [
        (None, ("--states", "observation.stat"), "unknown column 'observation.stat'"),
        (None, ("--task-from", "action"), "unknown column of one value 'action'"),
        (None, ("--task-from", "next.success"), "expected a column that stays the same in it"),
        (None, ("--states", "observation.state,observation.state"), "a column twice"),
        (_column("task_index", [7] * 9), (), "task_index 7 has no text"),
        (_column("task_index", ["a"] * 9), (), "task_index a has no text"),
        (_column("episode_index", [*range(9)]), (), "an episode of one row has no step"),
        (_column("action", ["a"] * 9), (), "wrong actions"),
        (_column("next.reward", ["a"] * 9), (), "wrong rewards"),
    ],
)
def test_what_makes_no_family(
    tmp_path: Path,
    run: Make,
    capsys: pytest.CaptureFixture[str],
    change: Any,
    words: Any,
    said: str,
) -> None:
    folder = tree(tmp_path / "theirs", "v3.0")
    if change is not None:
        change(folder)
    assert run("import", folder, *OWN, *words, "-o", "x.h5") in (1, 2)
    error = capsys.readouterr().err
    assert said in error and str(folder) in error and error.count("error:") == 1
    assert not Path("x.h5").exists()


def test_without_rewards_or_with_words_of_another_format(
    tmp_path: Path, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tree(tmp_path / "theirs", "v3.0", features={"next.reward": {"dtype": "video"}})
    assert run("import", folder, *OWN, "-o", "x.h5") == 1
    assert "no next.reward in it; expected the reward of each step" in (
        " ".join(capsys.readouterr().err.split())
    )
    for words, said in (
        (("--from", "npz", "--family-of", "a", "--states", "b"), "npz has one observation"),
        (("--from", "npz", "--family-of", "a", "--task-from", "b"), "no columns that name tasks"),
        ((*ML10, "--states", "b"), "--env, --task-from are of a family of its own"),
    ):
        assert run("import", folder, *words, "-o", "x.h5") == 2
        assert said in capsys.readouterr().err


def test_a_tree_of_their_own_writer(imported: Make, capsys: pytest.CaptureFixture[str]) -> None:
    """By lerobot 0.4.4: `benchmarks/ecosystem/write_lerobot.py`."""
    folder = Path(__file__).parents[2] / "golden/lerobot"
    data: Dataset = imported(folder, *OWN, "--task-from", "source")
    assert "with it the only success of 1" in capsys.readouterr().err
    assert data.tasks.names == ("Push_the_puck_then_stop", "reach-v3")
    assert data.contract().columns == ("x [1]", "y [1]", "z [1]", "gripper [1]")
    assert data.contract().step_s == 1 / 80 and data.episodes.length.tolist() == [3, 4, 5]
    push, reach = data.episode(0), data.episode(2)
    assert push.observations[:, 0].tolist() == [100, 110, 120, 130]
    assert reach.observations[1].tolist() == [210, 211, 212, 213]
    assert reach.actions[:, 3].tolist() == [0, 0.125, 0.25, 0.375, 0.5]
    assert reach.rewards.tolist() == [0, 1, 2, 3, 4]
    assert reach.successes is not None and reach.successes.tolist() == [False] * 3 + [True] * 2
    assert data.episodes.success.tolist() == [False, True, True]
