"""Training on several files is training on the file that merge makes of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

import mpdt
from mpdt.data.slices.merge import merge
from mpdt.data.slices.several import one_ref
from mpdt.data.store.reader import open_dataset
from mpdt.train.cli import _one_data
from mpdt.train.fit.data import return_table
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.names import name_of_data
from mpdt.train.run.prepare import prepare

from ..conftest import write
from .command import QUICK, call


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Random episodes in one file, medium and expert ones in the other, beside a merged one."""
    folder = tmp_path_factory.mktemp("data")
    found = [write(folder / "a.h5", {0: 2}), write(folder / "b.h5", {1: 2, 2: 4})]
    merge([open_dataset(path) for path in found], folder / "merged.h5")
    return found


def test_a_run_reads_the_same_and_says_of_which_files(files: list[Path]) -> None:
    joined, merged = (
        prepare(TrainConfig(), ref)
        for ref in (one_ref(files), str(files[0].with_name("merged.h5")))
    )
    said = joined.identity.training["data"].pop("files")
    assert said == [
        {"name": "tiny", "version": "1.0.0", "content_hash": open_dataset(path).content_hash}
        for path in files
    ]
    assert joined.identity == merged.identity
    table, same = (return_table(one.material, "task", 0.9) for one in (joined, merged))
    assert torch.equal(table.low, same.low) and torch.equal(table.target, same.target)


def test_a_run_by_the_command(files: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    runs = files[0].parent / "runs"
    short = ["--steps", "2", "--adapt.starts", "none", "--runs-dir", str(runs), "-q"]
    assert call("--data", *files, *QUICK, *short) == 0
    results = json.loads((runs / "a-b-smoke" / "results.json").read_text())
    assert results["data"]["file"] == "a.h5,b.h5"
    assert [one["version"] for one in results["data"]["files"]] == ["1.0.0", "1.0.0"]
    # Judged again, with the folder first and all files behind --data.
    capsys.readouterr()
    assert call("evaluate", runs / "a-b-smoke", "--data", *files, "--json", "-q") == 0
    assert json.loads(capsys.readouterr().out)["identity"] == results["identity"]
    # Found again beside the folder of runs.
    assert mpdt.load_policy(runs / "a-b-smoke", task="forward").act(np.zeros(20)).shape == (6,)


def test_what_cannot_be_one_is_refused_before_anything_is_written(
    files: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = write(tmp_path / "c.h5", {0: 2}, spec={"name": "tiny", "horizon": 8, "env": {}})
    assert call("--data", files[0], other, *QUICK, "--runs-dir", tmp_path / "runs") == 1
    error = capsys.readouterr().err
    assert "not made for one file: horizon" in error
    assert "a.h5 and " in error and "c.h5" in error
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("verb", "typed", "read"),
    [
        ("run", "--data a.h5 b.h5 -q", "--data a.h5,b.h5 -q"),
        ("run", "-q --data a.h5:few b.h5:few", "-q --data a.h5,b.h5:few"),
        ("run", "--data a.h5 --steps 3", "--data a.h5 --steps 3"),
        ("adapt", "runs/x --data a.h5 b.h5", "runs/x --data a.h5,b.h5"),
        ("adapt", "--data a.h5 runs/x", "--data a.h5 runs/x"),  # as it always was
        ("evaluate --policy", "--policy m:f --data a.h5 b.h5", "--policy m:f --data a.h5,b.h5"),
        ("rollout", "runs/x -o a.h5", "runs/x -o a.h5"),
    ],
)
def test_words_behind_data(verb: str, typed: str, read: str) -> None:
    assert _one_data(verb, typed.split()) == read.split()


def test_names_of_runs(files: list[Path]) -> None:
    folder = files[0].parent
    names = {"a.h5": "a", "a.h5:few": "a", "x/a.h5,x/b.h5": "a-b", "x/parts/*.h5": "parts",
             "a.h5,b.h5,c.h5,d.h5": "a-and-3-more", str(folder): folder.name}  # fmt: skip
    assert {ref: name_of_data(ref) for ref in names} == names
