"""Scripts under experiments/: each starts, and a file that is not there is one error, no traceback.

What they find out costs minutes to hours and is kept under results/experiments.
"""

import runpy
import sys
from pathlib import Path

import pytest
import torch

FOLDER = Path(__file__).parents[1] / "experiments"
SCRIPTS = sorted(path.name for path in FOLDER.glob("*.py") if "__main__" in path.read_text())
RUN = ["--cell", "ml45.MPDT-ones.s0", "--run", "runs/x"]
NOWHERE = {
    "closed_loop_study.py": ["nowhere.h5", "--only", "no-return"],
    "error_and_returns.py": ["nowhere.h5"],
    "held_out_classes.py": ["nowhere.h5", *RUN],
    "held_out_few_shot.py": ["nowhere.h5", *RUN, "--try", "updates=1"],
    "held_out_tasks.py": ["runs/none", "--data", "nowhere.h5"],
    "known_tasks.py": ["nowhere.h5"],
    "metaworld_one_step.py": ["nowhere.h5"],
    "transfer_matrix.py": ["runs/none", "--data", "nowhere.h5"],
    "transfer_picture.py": ["nowhere.h5", "x.svg"],
    "trials.py": ["nowhere.h5", "--leave-out", "reach", "--run", "runs/x"],
}


@pytest.fixture
def run(monkeypatch, tmp_path):
    """Run a script as `python experiments/NAME WORDS` does; what it exits with."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setattr(torch, "set_num_threads", lambda number: None)  # it would stay so
    monkeypatch.chdir(tmp_path)

    def run(name, *words):
        monkeypatch.setattr(sys, "argv", [name, *words])
        with pytest.raises(SystemExit) as stopped:
            runpy.run_path(str(FOLDER / name), run_name="__main__")
        return stopped.value.code

    yield run
    for name in set(sys.modules) - before:
        if str(FOLDER) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_script_says_what_it_asks(run, name, capsys):
    assert run(name, "--help") == 0
    assert "usage:" in capsys.readouterr().out


@pytest.mark.parametrize("name", NOWHERE)
def test_a_file_that_is_not_there_is_one_error(run, name):
    told = run(name, *NOWHERE[name])
    assert str(told).startswith("error: ") and "\n  File" not in told
    named = "no-return" if name == "closed_loop_study.py" else NOWHERE[name][0]
    assert named in told
