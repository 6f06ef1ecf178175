"""The list of breaks is up to date; `python tools/mutants.py` runs it by hand."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


def load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("mutants", ROOT / "tools/mutants.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["mutants"] = module  # its dataclasses look themselves up
    spec.loader.exec_module(module)
    return module


MUTANTS = load()
BREAKS = MUTANTS.read_list()


def test_every_break_fits_its_file_and_still_compiles() -> None:
    """Else: say in tools/mutants.toml what the line says now, or break another one."""
    for one in BREAKS:
        text = (ROOT / one.file).read_text()
        assert text.count(one.old) == 1, f"{one.file}: {one.old!r}"
        assert one.new != one.old and one.tests, f"{one.file}: {one.old!r}"
        compile(text.replace(one.old, one.new), one.file, "exec")
        for test in one.tests:
            assert (ROOT / test.partition("::")[0]).is_file(), f"{one.file}: {test}"


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A tree of one file and a test that looks at half of it."""
    (tmp_path / "shop.py").write_text("x, y = 1, 2\n")
    (tmp_path / "test_shop.py").write_text(
        "from shop import x\n\ndef test_x():\n    assert x == 1\n"
    )
    (tmp_path / "pyproject.toml").write_text("[tool.pytest.ini_options]\npythonpath = ['.']\n")
    return tmp_path


def test_who_notices_is_named_and_the_file_is_mended(tree: Path) -> None:
    """The same break twice: with a test that looks at it and without."""
    noticed = MUTANTS.Break("shop.py", "= 1,", "= 3,", ("test_shop.py",))
    found = MUTANTS.try_break(noticed, tree)
    assert (found["outcome"], found["by"]) == ("noticed", "test_shop.py::test_x")
    survived = MUTANTS.Break("shop.py", ", 2", ", 3", ("test_shop.py",))
    assert MUTANTS.try_break(survived, tree)["outcome"] == "survived"
    assert (tree / "shop.py").read_text() == "x, y = 1, 2\n"


def test_a_break_that_is_not_there_or_that_nothing_runs_on_is_refused(tree: Path) -> None:
    for old, new, tests, said in (
        ("= 7,", "= 8,", "test_shop.py", "expected once, found 0"),
        ("= 1,", "= ,", "test_shop.py", "pytest ended with 2"),
        ("= 1,", "= 3,", "test_shop.py::test_z", "pytest ended with 4"),
    ):
        with pytest.raises(SystemExit, match=said):
            MUTANTS.try_break(MUTANTS.Break("shop.py", old, new, (tests,)), tree)
