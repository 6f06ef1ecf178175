"""A run of seconds on the tiny file, whose bundle acts in the real simulator of cheetah_dir."""

from __future__ import annotations

import shutil

import pytest

from mpdt.train.cli import main

QUICK = [
    *("--preset", "smoke", "--threads", "1", "--inputs.previous-action"),
    *("--inputs.return-to-go", "task"),
    *("--teacher.steps", "1", "--multitask.steps", "2", "--statistics.batches", "1"),
    *("--adapt.starts", "cross", "--adapt.steps", "1", "--evaluation.horizon", "3"),
    *("--evaluation.episodes", "2", "--few-shot.qualities"),
]


def run(*words: object) -> int:
    """The exit code of mpdt-train."""
    with pytest.raises(SystemExit) as stopped:
        main([str(word) for word in words])
    return int(stopped.value.code or 0)


@pytest.fixture(scope="session")
def trained(planned_file, tmp_path_factory):
    """Folder of the run; its data lies two folders above."""
    work = tmp_path_factory.mktemp("rolled")
    shutil.copy(planned_file, work / "tiny.h5")
    words = ["--data", work / "tiny.h5", *QUICK, "--runs-dir", work / "runs", "--name", "r"]
    assert run(*words, "-q") == 0
    return work / "runs" / "r"
