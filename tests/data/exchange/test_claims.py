"""What a source says of its episodes counts; who says otherwise is told of both."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from mpdt.data.exchange.claims import Said, named
from mpdt.data.exchange.minari_claims import said_in
from mpdt.data.exchange.treatment import Rules
from mpdt.data.slices.merge import merge
from mpdt.data.spec.tasks import get_family
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.licence import combined
from mpdt.data.store.reader import open_dataset
from mpdt.errors import DataError

Make = Callable[..., Any]
DIR = ("--family", "cheetah_dir", "--horizon", 5)


@pytest.fixture
def flat(collected: Path, run: Make) -> Path:
    """`out/`: a flat file for every task and quality of tiny.h5."""
    assert run("export", collected, "--to", "d4rl", "-o", "out") == 0
    return Path("out")


@pytest.mark.parametrize(
    ("words", "sides"),
    [
        (("--task", "forward"), ("forward", "backward in its attributes and its name")),
        (("--quality", "medium"), ("medium", "expert in its attributes and its name")),
        (("--license", "CC0-1.0"), ("CC0-1.0", "MIT in its attributes")),
        (("--family", "cheetah_vel"), ("cheetah_vel", "cheetah_dir in its attributes")),
    ],
)
def test_options_against_a_flat_file(
    flat: Path, run: Make, capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...], sides: tuple[str, str],
) -> None:  # fmt: skip
    file = flat / "cheetah_dir-backward-expert.hdf5"
    assert run("import", file, "--from", "d4rl", *DIR, *words, "-o", "x.h5") == 1
    error = capsys.readouterr().err
    assert f"expected {sides[0]}, found {sides[1]}" in error and str(file) in error
    assert not Path("x.h5").exists()


def test_the_name_of_a_flat_file_speaks_where_its_attributes_are_gone(
    flat: Path, run: Make, imported: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    file = flat / "cheetah_dir-backward-expert.hdf5"
    with h5py.File(file, "r+") as opened:
        for key in list(opened.attrs):
            del opened.attrs[key]
    words = ("--from", "d4rl", *DIR)
    assert run("import", file, *words, "--task", "forward", "-o", "x.h5") == 1
    assert "found backward in its name" in capsys.readouterr().err
    # Its goal still says which task it is of.
    other = file.rename(flat / "some.hdf5")
    assert run("import", other, *words, "--task", "forward", "-o", "x.h5") == 1
    assert "another goal than that of task forward" in capsys.readouterr().err
    data: Dataset = imported(other, *words, "--task", "backward", "--license", "MIT")
    assert (data.tasks.names, data.license) == (("backward",), "MIT")
    assert (data.episodes.quality == -1).all()


def test_a_file_that_contradicts_itself(
    flat: Path, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    file = flat / "cheetah_dir-forward-expert.hdf5"
    (flat / "cheetah_dir-backward-expert.hdf5").replace(file)
    assert run("import", file, "--from", "d4rl", *DIR, "-o", "x.h5") == 1
    assert "backward in its attributes, forward in its name" in capsys.readouterr().err


def test_a_name_of_d4rl_says_its_quality(
    flat: Path, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    file = flat / "halfcheetah_medium-v2.hdf5"
    with h5py.File(flat / "cheetah_dir-forward-medium.hdf5") as opened, h5py.File(file, "w") as new:
        for name in opened:
            opened.copy(name, new)
    words = ("--from", "d4rl", *DIR, "--task", "forward", "-o", "x.h5")
    assert run("import", file, *words, "--quality", "expert") == 1
    assert "expected expert, found medium in its name" in capsys.readouterr().err


def test_metadata_of_minari(
    collected: Path, run: Make, imported: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("export", collected, "--to", "minari", "-o", "m") == 0
    folder, words = Path("m/mpdt/cheetah_dir/backward/expert-v1"), ("--from", "minari", *DIR)
    for option, value, said in (
        ("--task", "forward", "backward"), ("--quality", "medium", "expert"),
        ("--license", "CC0-1.0", "MIT"), ("--family", "cheetah_vel", "cheetah_dir"),
    ):  # fmt: skip
        assert run("import", folder, *words, option, value, "-o", "x.h5") == 1
        assert f"expected {value}, found {said} in its" in capsys.readouterr().err
    data: Dataset = imported(folder, *words)
    assert data.tasks.names == ("backward",) and set(data.episodes.quality.tolist()) == {2}
    assert data.license == "MIT" and data.goals.of(0).tolist() == [-1.0]
    # Each part speaks where the others are gone: here only the options of the episodes are left.
    metadata = json.loads((folder / "data/metadata.json").read_text())
    for key in ("dataset_id", "env_spec", "mpdt"):
        del metadata[key]
    (folder / "data/metadata.json").write_text(json.dumps(metadata))
    assert run("import", folder, *words, "--task", "forward", "-o", "x.h5") == 1
    assert "forward in the command line, backward in its options" in capsys.readouterr().err
    Path("imported.h5").unlink()
    taken_back: Dataset = imported(
        folder, *words, "--task", "backward", "--quality", "unknown", "--license", "MIT"
    )
    assert set(taken_back.episodes.quality.tolist()) == {-1}


def test_the_environment_that_a_minari_set_names() -> None:
    def said(**arguments: str) -> Said:
        metadata = {"env_spec": json.dumps({"kwargs": arguments})}
        return said_in(metadata, get_family("ml10"), "x")

    assert said(env_name="reach-v3").task == "reach"
    assert said(env_name="Walker2d-v5").task == ""
    ours = said(family="ml10", task="push")
    assert (ours.family, ours.task) == ("ml10", "push")
    cheetah = said_in({"env_spec": '{"kwargs": {"env_name": "reach-v3"}}'},
                      get_family("cheetah_dir"), "x")  # fmt: skip
    assert cheetah.task == ""


def test_names_and_folders_of_pickles(
    tmp_path: Path, episode: Make, dump: Make, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    def told(path: str, *words: object) -> str:
        dump([episode(5)], tmp_path / path)
        assert run("import", path, "--from", "promptdt", *words, "-o", "x.h5") == 1
        return capsys.readouterr().err

    error = told("cheetah_dir-1-expert.pkl", *DIR, "--task", "forward")
    assert "expected forward, found backward in its name" in error
    error = told("cheetah_dir-1-expert.pkl", *DIR, "--quality", "random")
    assert "expected random, found expert in its name" in error
    error = told("data/ant_dir/cheetah_dir-1-expert.pkl", *DIR)
    assert "cheetah_dir in its name, ant_dir in its folder" in error
    error = told("ML1-reach-v2-0-expert.pkl", "--family", "ml10", "--task", "push")
    assert "expected push, found reach in its name" in error
    error = told("walker-1-expert.pkl", *DIR)
    assert "another family" in error and "found walker" in error


def test_tasks_in_prompts_of_mtdiff(
    tmp_path: Path, episode: Make, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    episodes = np.empty(1, object)
    episodes[0] = episode(4, sizes=(39, 4)) | {"task": "push-v2"}
    np.save(tmp_path / "reach-v2_prompt.npy", episodes, allow_pickle=True)
    words = ("--from", "mtdiff", "--family", "ml10", "--horizon", 4, "--hide-goal", "-o", "x.h5")
    assert run("import", "reach-v2_prompt.npy", *words) == 1
    assert "expected reach, found push-v2" in capsys.readouterr().err
    assert run("import", "reach-v2_prompt.npy", *words, "--task", "push") == 1
    assert "expected push, found reach in its name" in capsys.readouterr().err


@pytest.mark.parametrize("form", ["npz", "parquet", "minari"])
def test_a_licence_for_an_export_that_has_one(
    collected: Path, run: Make, capsys: pytest.CaptureFixture[str], form: str
) -> None:
    assert run("export", collected, "--to", form, "-o", "ex") == 0
    assert run("import", "ex", "--from", form, "--license", "MIT", "-o", "x.h5") == 2
    assert "--family" in capsys.readouterr().err


def test_what_is_said_of_a_source() -> None:
    rules = Rules("d4rl", get_family("ml10"), 10, quality="unknown")
    said = Said(family="ml10", task="reach", quality="expert", by="its name")
    assert said.settled(rules, "x").quality == "unknown", "taken back"
    assert Said(quality="unknown").settled(rules, "x").quality == "unknown"
    assert named("ml10-pick-place-wall-expert", "n").task == ""  # of ml45
    assert named("ml45-pick-place-wall-expert", "n").task == "pick-place-wall"
    assert Said.of({"task": b"push", "family": 3}, "x") == Said(task="push", by="x")
    with pytest.raises(DataError, match="push in a, reach in b"):
        Said(task="push", by="a").and_also(Said(task="reach", by="b"), "x")


# ---- licences and provenance of a merge ----


@pytest.mark.parametrize(
    ("licences", "wanted"),
    [
        (["MIT", "MIT"], "MIT"),
        (["MIT", "CC-BY-NC-4.0"], "MIT AND CC-BY-NC-4.0"),
        (["MIT AND CC0-1.0", "CC0-1.0"], "MIT AND CC0-1.0"),
        (["MIT OR Apache-2.0", "MIT"], "(MIT OR Apache-2.0) AND MIT"),
        (["MIT", "NOASSERTION"], "MIT AND NOASSERTION"),
        (["(MIT OR CC0-1.0) AND MIT", ""], "(MIT OR CC0-1.0) AND MIT AND NOASSERTION"),
        ([], "NOASSERTION"),
    ],
)
def test_licences_together(licences: list[str], wanted: str) -> None:
    assert combined(licences) == wanted


def test_a_merge_keeps_every_source(tmp_path: Path, episode: Make, dump: Make, run: Make) -> None:
    one = episode(3)
    one["actions"][0, 0] = 4.0
    dump([one], tmp_path / "cheetah_vel-0-expert.pkl")
    dump([episode(3, 100.0)], tmp_path / "cheetah_vel-1-expert.pkl")
    vel = ("--from", "promptdt", "--family", "cheetah_vel", "--horizon", 3)
    assert run("import", "cheetah_vel-0-expert.pkl", *vel, "--clip-actions", "--license", "MIT",
               "-o", "a.h5") == 0  # fmt: skip
    assert run("import", "cheetah_vel-1-expert.pkl", *vel, "--license", "CC-BY-NC-4.0",
               "-o", "b.h5") == 0  # fmt: skip
    assert run("merge", "a.h5", "b.h5", "-o", "ab.h5") == 0
    data = open_dataset("ab.h5")
    assert data.license == "MIT AND CC-BY-NC-4.0"
    first, second = data.spec["import"]["sources"]
    assert (first["name"], first["license"], first["clip_actions"]) == (
        "cheetah_vel-0-expert.pkl", "MIT", True,
    )  # fmt: skip
    assert first["clipped"]["largest"] == 4.0 and first["from"] == "promptdt"
    assert (second["license"], second["clip_actions"]) == ("CC-BY-NC-4.0", False)
    step = data.lineage[-1]
    assert [said["license"] for said in step["sources"]] == ["MIT", "CC-BY-NC-4.0"]
    assert [said["name"] for said in step["sources"]] == ["a", "b"]
    # Merged again with one of them, nothing is said twice.
    again = merge([data, open_dataset("b.h5")], tmp_path / "again.h5").dataset
    assert again.license == data.license and again.spec["import"] == data.spec["import"]


def test_imports_that_agree_stay_one_import(
    tmp_path: Path, episode: Make, dump: Make, run: Make
) -> None:
    for i in (0, 1):
        dump([episode(3, 100.0 * i)], tmp_path / f"cheetah_vel-{i}-expert.pkl")
        words = ("--from", "promptdt", "--family", "cheetah_vel", "--horizon", 3, "-o", f"{i}.h5")
        assert run("import", f"cheetah_vel-{i}-expert.pkl", *words, "--license", "MIT") == 0
    assert run("merge", "0.h5", "1.h5", "-o", "both.h5") == 0
    data = open_dataset("both.h5")
    said = data.spec["import"]
    assert data.license == "MIT" and said["from"] == "promptdt" and len(said["sources"]) == 2
    assert "license" not in said["sources"][0]


# ---- numbers ----


def test_numbers_are_checked_first_and_compared_as_they_are_stored(
    tmp_path: Path, episode: Make, dump: Make, run: Make, imported: Make,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    vel = ("--from", "promptdt", "--family", "cheetah_vel", "--horizon", 3)
    one = episode(3, 0.1)
    one["observations"][2, 0] = np.nan
    dump([one], tmp_path / "cheetah_vel-0-expert.pkl")
    assert run("import", "cheetah_vel-0-expert.pkl", *vel, "-o", "x.h5") == 1
    assert "1 numbers in observations are NaN or infinite" in capsys.readouterr().err
    rows = np.random.Generator(np.random.PCG64(0)).normal(size=(4, 20))  # not exact in float32
    one = episode(3) | {
        "observations": rows[:-1], "next_observations": rows[1:].astype(np.float32),
    }  # fmt: skip
    dump([one], tmp_path / "cheetah_vel-0-expert.pkl")
    data: Dataset = imported("cheetah_vel-0-expert.pkl", *vel)
    np.testing.assert_array_equal(data.episode(0).observations, rows.astype(np.float32))


def test_rewards_without_an_axis(
    tmp_path: Path, episode: Make, dump: Make, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    dump(
        [episode(3) | {"rewards": np.zeros((), np.float32)}], tmp_path / "cheetah_vel-0-expert.pkl"
    )
    vel = ("--from", "promptdt", "--family", "cheetah_vel", "--horizon", 3)
    assert run("import", "cheetah_vel-0-expert.pkl", *vel, "-o", "x.h5") == 1
    assert "wrong rewards; expected (T,) or (T, 1), found ()" in capsys.readouterr().err


def test_a_long_set_of_minari_says_its_length_at_once(
    tmp_path: Path, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "set/data"
    folder.mkdir(parents=True)
    with h5py.File(folder / "main_data.hdf5", "w") as file:
        group = file.create_group("episode_0")
        group["observations"], group["actions"] = np.zeros((1001, 20)), np.zeros((1000, 6))
        for name in ("rewards", "terminations", "truncations"):
            group[name] = np.zeros(1000)
    (folder / "metadata.json").write_text('{"data_format": "hdf5", "total_episodes": 1}')
    words = ("--from", "minari", "--family", "cheetah_dir", "--task", "forward", "-o", "x.h5")
    assert run("import", "set", *words) == 1
    error = capsys.readouterr().err
    assert "expected 1 to 200 steps, found 1000" in error and "--horizon 1000" in error
