"""The list of breaks is up to date; `python tools/mutants.py` runs it by hand."""

from __future__ import annotations

import importlib
import multiprocessing
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def mutants() -> Iterator[ModuleType]:
    """The script, under its own name: processes look for what they shall do by that."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "tools")
        module = importlib.import_module("mutants")
        patch.setattr(module, "CONTEXT", multiprocessing.get_context("spawn"))  # no large library
        yield module
        del sys.modules["mutants"]


def test_every_break_fits_its_file_and_still_compiles(mutants: ModuleType) -> None:
    """Else: say in tools/mutants.toml what the line says now, or break another one."""
    for one in mutants.read_list():
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


def test_who_notices_is_named_and_the_file_is_mended(mutants: ModuleType, tree: Path) -> None:
    """The same break twice: with a test that looks at it and without."""
    noticed = mutants.Break("shop.py", "= 1,", "= 3,", ("test_shop.py",))
    found = mutants.try_break(noticed, tree)
    assert (found["outcome"], found["by"]) == ("noticed", "test_shop.py::test_x")
    survived = mutants.Break("shop.py", ", 2", ", 3", ("test_shop.py",))
    assert mutants.try_break(survived, tree)["outcome"] == "survived"
    assert (tree / "shop.py").read_text() == "x, y = 1, 2\n"


def test_what_says_nothing_about_the_tests_is_refused(
    mutants: ModuleType, tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A text that is not there; a run that ended without a test that failed."""
    with pytest.raises(SystemExit, match="expected once, found 0"):
        mutants.try_break(mutants.Break("shop.py", "= 7,", "= 8,", ("test_shop.py",)), tree)
    for code, text in ((1, "Traceback"), (2, "ERROR test_shop.py"), (4, ""), (-9, "")):
        monkeypatch.setattr(mutants, "run_tests", lambda *_, found=(code, text): found)
        with pytest.raises(SystemExit, match=f"pytest ended with {code}"):
            mutants.try_break(mutants.Break("shop.py", "= 1,", "= 3,", ("test_shop.py",)), tree)
    monkeypatch.setattr(mutants, "run_tests", lambda *_: (None, ""))
    hangs = mutants.try_break(mutants.Break("shop.py", "= 1,", "= 3,", ("test_shop.py",)), tree)
    assert hangs["outcome"] == "hangs"
    assert (tree / "shop.py").read_text() == "x, y = 1, 2\n"
