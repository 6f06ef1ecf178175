"""A tiny finished run with its bundle, and whole runs' worth of untrained policies."""

from __future__ import annotations

import shutil

import pytest

from mpdt.train.cli import main

QUICK = [
    *("--preset", "smoke", "--threads", "1", "--inputs.return-to-go", "task"),
    *("--teacher.steps", "2", "--multitask.steps", "4", "--statistics.batches", "1"),
    *("--adapt.starts", "cross", "--adapt.steps", "1", "--evaluation.horizon", "3"),
    *("--evaluation.episodes", "2", "--evaluation.no-constants", "--few-shot.qualities", "expert"),
    *("--few-shot.steps", "4", "--few-shot.updates", "1"),
]


def run(*words: object) -> int:
    """The exit code of mpdt-train."""
    with pytest.raises(SystemExit) as stopped:
        main([str(word) for word in words])
    return int(stopped.value.code or 0)


@pytest.fixture(scope="session")
def finished(tiny_file, tmp_path_factory):
    """Folder of a run, and its data where it is looked for."""
    work = tmp_path_factory.mktemp("bundles")
    shutil.copy(tiny_file, work / tiny_file.name)
    words = ["--data", work / tiny_file.name, *QUICK, "--runs-dir", work / "runs", "--name", "r"]
    assert run(*words, "-q") == 0
    return work / "runs" / "r"


@pytest.fixture(scope="session")
def bundle(finished, tmp_path_factory):
    """The bundle alone, far from its run and data."""
    return shutil.copytree(finished / "policy", tmp_path_factory.mktemp("far") / "policy")
