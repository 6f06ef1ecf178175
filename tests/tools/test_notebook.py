"""docs/first_steps.ipynb: it shows what its cells give, and they run."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs/first_steps.ipynb"
CELLS = json.loads(PAGE.read_text("utf-8"))["cells"]
CODE = [cell for cell in CELLS if cell["cell_type"] == "code"]


def test_what_it_shows() -> None:
    """Else: tools/run_notebook.py. A code cell that ends in a value shows one; none an error."""
    for cell in CODE:
        source = "".join(cell["source"])
        assert not [out for out in cell["outputs"] if out["output_type"] != "execute_result"], cell
        last = ast.parse(re.sub(r"^!.*", "pass", source, flags=re.M)).body[-1]
        assert bool(cell["outputs"]) == isinstance(last, ast.Expr), source
    shown = [out["data"] for cell in CODE for out in cell["outputs"]]
    assert sum("text/html" in data for data in shown) == 4  # two data sets, slices, results
    assert sum("image/png" in data for data in shown) == 1
    assert PAGE.stat().st_size < 500_000


PROLOGUE = """
import subprocess, sys, types
def shell(line):
    words = line.split(" ", 1)
    module = {"mpdt-train": "mpdt.train.cli", "mpdt-data": "mpdt.data.cli"}[words[0]]
    subprocess.run(f"{sys.executable} -m {module} {words[1]}", shell=True, check=True)
display = types.ModuleType("IPython.display")
display.Image = lambda path: open(path, "rb").read()
sys.modules["IPython"] = sys.modules["IPython.display"] = display
"""


@pytest.mark.slow
def test_it_runs_in_small(tmp_path: Path) -> None:
    """As a program: a line with an exclamation mark is a command, as in IPython."""
    code = "\n".join("".join(cell["source"]) for cell in CODE)
    assert "SMALL = False" in code
    code = code.replace("SMALL = False", "SMALL = True")
    code = re.sub(r"^!(.*)$", lambda line: f"shell(f{line[1]!r})", code, flags=re.M)
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PROLOGUE + code], cwd=tmp_path, text=True,
        capture_output=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "strip.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "runs/first/policy/config.json").exists()
