"""One run and one study cell open their file once, name themselves once, load one backbone."""

from collections import Counter

import h5py
import pytest

from mpdt.train.run import pipeline, prepare
from mpdt.train.run.progress import Progress
from mpdt.train.study.recipes import Cell
from mpdt.train.study.study import Places, run_study

from .command import QUICK, call

# The file once more beside the work: what the simulator paid in X is proven, and never trained on.
ONCE = {"file": 2, "settings": 1, "identity": 1, "backbone": 1}


@pytest.fixture
def counted(tiny_file, monkeypatch):
    """How often each was done."""
    counts = Counter()

    def count(module, name, what):
        plain = getattr(module, name)

        def counting(*arguments, **options):
            counts[what] += 1
            return plain(*arguments, **options)

        monkeypatch.setattr(module, name, counting)

    class File(h5py.File):
        def __init__(self, *arguments, **options):
            counts["file"] += 1
            super().__init__(*arguments, **options)

    monkeypatch.setattr(h5py, "File", File)
    count(prepare, "plain_settings", "settings")
    count(prepare, "identify", "identity")
    count(pipeline, "from_settings", "backbone")
    return counts


def test_a_run(tiny_file, tmp_path, counted):
    assert call("--data", tiny_file, *QUICK, "--runs-dir", tmp_path, "--name", "r", "-q") == 0
    assert counted == ONCE


def test_a_study_cell(tiny_file, tmp_path, counted):
    changes = {
        "inputs": {"time_table": 16}, "evaluation": {"horizon": 3, "episodes": 2},
        "statistics": {"batches": 1}, "adapt": {"steps": 1}, "multitask": {"steps": 2},
    }  # fmt: skip
    cell = Cell("tiny", "Soft-Prompt-TTA", preset="smoke", changes=changes)
    places = Places(tiny_file.parent, tmp_path / "runs", tmp_path / "results")
    assert [done.state for done in run_study([cell], places, Progress(quiet=True))] == ["done"]
    assert counted == ONCE
