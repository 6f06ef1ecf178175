"""One .npz: numbers in their rows, the same content hash after a round trip, damage is found."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mpdt.data.slices.cut import Cut, cut_file
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset

Make = Callable[..., Any]


@pytest.fixture
def export(collected: Path, run: Make) -> Path:
    assert run("export", collected, "--to", "npz", "-o", "out") == 0
    (path,) = Path("out").iterdir()
    return path


def test_rows_are_where_the_drawing_says(export: Path, collected: Path) -> None:
    data = open_dataset(collected)
    with np.load(export) as arrays:  # as anyone would; objects are not allowed by default
        assert export.name == "tiny.npz"
        valids = arrays["valids"]
        # 32 episodes of 5 steps: every sixth row is no step.
        assert valids.tolist() == ([True] * 5 + [False]) * 32
        np.testing.assert_array_equal(arrays["observations"], data.steps.observations)
        np.testing.assert_array_equal(arrays["actions"][valids], data.steps.actions)
        assert not arrays["actions"][~valids].any() and not arrays["rewards"][~valids].any()
        np.testing.assert_array_equal(arrays["truncations"][valids], data.steps.truncations)
        assert arrays["episodes/length"].tolist() == [5] * 32
        np.testing.assert_array_equal(arrays["episodes/return"], data.episodes.returns)


def test_out_and_in_again_is_the_same_data(export: Path, collected: Path, imported: Make) -> None:
    back: Dataset = imported("out", "--from", "npz")
    data = open_dataset(collected)
    assert back.content_hash == data.content_hash
    assert (back.name, back.version, back.spec) == (data.name, data.version, data.spec)
    assert back.packages == data.packages and back.policies.names == data.policies.names
    assert repr(back.tasks.references) == repr(data.tasks.references)  # NaN
    assert set(back.slices) == set(data.slices) and back.episodes.source is None


def test_a_slice_is_the_same_data_as_the_cut_file(
    collected: Path, run: Make, imported: Make, tmp_path: Path
) -> None:
    assert run("export", collected, "--slice", "medium", "--to", "npz", "-o", "out") == 0
    back: Dataset = imported("out/tiny.npz", "--from", "npz")
    data = open_dataset(collected)
    cut = cut_file(data, Cut(quality="medium"), tmp_path / "medium.h5")
    assert back.content_hash == cut.content_hash
    assert back.parent == data.content_hash
    step = {"verb": "export", "rule": {"slice": "medium"}, "from": [data.content_hash]}
    assert [dict(one) for one in back.lineage] == [step]
    assert back.episodes.source is not None and cut.episodes.source is not None
    assert back.episodes.source.tolist() == cut.episodes.source.tolist()


def test_a_slice_of_one_task_has_tables_of_its_own(
    collected: Path, run: Make, imported: Make, tmp_path: Path
) -> None:
    """Task, policy and goal rows of `backward` start again at 0."""
    shutil.copy(collected, "all.h5")
    assert run("split", "all.h5", "--tasks", "backward", "--name", "back") == 0
    assert run("export", "all.h5:back", "--to", "npz", "-o", "out") == 0
    back: Dataset = imported("out", "--from", "npz")
    cut = cut_file(open_dataset(collected), Cut(tasks=("backward",)), tmp_path / "cut.h5")
    assert back.tasks.names == ("backward",) and back.content_hash == cut.content_hash
    with np.load("out/tiny.npz") as arrays:
        assert not arrays["episodes/task"].any() and not arrays["episodes/goal"].any()
        assert sorted(set(arrays["episodes/policy"].tolist())) == list(
            range(len(back.policies.names))
        )


def test_a_cut_file_stays_one(collected: Path, run: Make, imported: Make, tmp_path: Path) -> None:
    data = open_dataset(collected)
    cut = cut_file(data, Cut(tasks=("backward",)), tmp_path / "backward.h5")
    assert run("export", "backward.h5", "--to", "npz", "-o", "out") == 0
    back: Dataset = imported("out", "--from", "npz")
    assert (back.content_hash, back.parent) == (cut.content_hash, data.content_hash)
    assert cut.episodes.source is not None and back.episodes.source is not None
    assert back.episodes.source.tolist() == cut.episodes.source.tolist()


def rewritten(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    with np.load(path) as archive:
        arrays = dict(archive)
    change(arrays)
    np.savez(path, allow_pickle=True, **arrays)


def put(name: str, value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda arrays: arrays.update({name: value})


def add(name: str, place: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(arrays: dict[str, Any]) -> None:
        arrays[name] = arrays[name].copy()
        arrays[name][place] += value

    return change


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (add("rewards", 0, 1), "not the episodes that were exported"),
        (add("episodes/progress", 0, 0.25), "not the episodes that were exported"),
        (add("goals/values", 0, 1), "not the episodes that were exported"),
        (add("episodes/task", 0, 2), "column task points outside its table"),
        (add("episodes/policy", 0, -1), "column policy points outside its table"),
        (add("episodes/length", 0, 1), "lengths do not fit; expected 160 steps, found 161"),
        (add("episodes/length", [0, 1], [-5, 5]), "lengths do not fit; expected 160 steps"),
        (put("episodes/quality", np.zeros(32)), "column quality is wrong"),
        (put("rewards", np.zeros(5, np.float32)), "array rewards is wrong"),
        (put("rewards", np.zeros(192)), "array rewards is wrong; expected <f4 of shape (192,)"),
        (put("actions", np.array([{}], object)), "array actions is wrong"),
        (lambda arrays: arrays.pop("terminations"), "array terminations is wrong"),
        (lambda arrays: arrays.pop("episodes/seed_key"), "column seed_key is missing"),
        (lambda arrays: arrays.pop("mpdt"), "damaged, or not an export of mpdt"),
        (put("mpdt", np.frombuffer(b"{}", np.uint8)), "not an export of mpdt, or changed"),
        (put("mpdt", np.frombuffer(b"[" * 90_000, np.uint8)), "not an export of mpdt, or changed"),
    ],
)
def test_changes_are_found(
    export: Path, run: Make, capsys: pytest.CaptureFixture[str],
    change: Callable[[dict[str, Any]], None], text: str,
) -> None:  # fmt: skip
    rewritten(export, change)
    assert run("import", export, "--from", "npz", "-o", "x.h5") == 1
    assert text in capsys.readouterr().err
    assert not list(Path().glob("x.h5*"))


def test_bytes_that_are_no_archive(
    export: Path, run: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    huge = (
        b"\x93NUMPY\x01\x00v\x00"
        + b"{'descr': '<f8', 'fortran_order': False, 'shape': (%d,)}" % (1 << 50)
    )
    with zipfile.ZipFile("huge.npz", "w") as archive:
        archive.writestr("mpdt.npy", huge.ljust(127) + b"\n")
    Path("text.npz").write_text("no archive")
    Path("short.npz").write_bytes(export.read_bytes()[:-100])
    for name in ("huge.npz", "text.npz", "short.npz"):
        assert run("import", name, "--from", "npz", "-o", "x.h5") == 1
        told = (
            "not an .npz file; found text"
            if name == "text.npz"
            else ("damaged, or not an export of mpdt")
        )
        assert told in capsys.readouterr().err
    shutil.copy(export, "out/again.npz")
    assert run("import", "out", "--from", "npz", "-o", "x.h5") == 1
    assert run("import", "absent", "--from", "npz", "-o", "x.h5") == 2
    (tmp_path / "empty").mkdir()
    assert run("import", "empty", "--from", "npz", "-o", "x.h5") == 2


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--family", "cheetah_dir"), "npz is read only where mpdt wrote it"),
        (("--quality", "expert"), "options for foreign data need a family"),
        (("--clip-actions",), "options for foreign data need a family"),
        (("--quality", "exprt"), "did you mean 'expert'"),
    ],
)
def test_options_for_foreign_data_are_refused(
    export: Path, run: Make, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], text: str
) -> None:
    assert run("import", export, "--from", "npz", *words, "-o", "x.h5") == 2
    assert text in capsys.readouterr().err
