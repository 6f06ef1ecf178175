"""The house keeps its shape: import arrows, small files, no drawers, a quick `--help`."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SOURCES = sorted((ROOT / "mpdt").rglob("*.py"))
HEAVY = {"torch", "transformers", "mujoco", "metaworld", "h5py", "pyarrow", "gymnasium"}


def test_imports_point_one_way() -> None:
    """The contracts in pyproject.toml: layers, and no deep-learning library below the model."""
    command = [str(Path(sys.executable).parent / "lint-imports"), "--no-cache"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_are_small_and_named_after_a_noun(path: Path) -> None:
    assert path.stem not in {"util", "utils", "helper", "helpers", "common", "misc"}
    text = path.read_text()
    assert text.count("\n") <= 330
    if text.strip():
        assert ast.get_docstring(ast.parse(text)), "a module says what it is"


@pytest.mark.parametrize("module", ["mpdt.data.cli", "mpdt.train.cli"])
def test_help_imports_nothing_heavy(module: str) -> None:
    code = (
        "import sys, importlib\n"
        f"main = importlib.import_module({module!r}).main\n"
        "sys.argv = ['prog', '--help']\n"
        "try:\n    main()\nexcept SystemExit as stop:\n    assert not stop.code, stop.code\n"
        f"print('HEAVY', sorted({HEAVY!r} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "HEAVY []"


def test_no_global_random_generator_is_used() -> None:
    """All randomness comes from named seeds; these calls would draw from global state."""
    banned = ("np.random.seed", "np.random.rand", "random.random(")
    for path in SOURCES:
        text = path.read_text()
        assert not [call for call in banned if f" {call}" in text], path
        if "torch.manual_seed" in text:  # layers that only know the global one: fork it
            assert "fork_rng" in text, path
