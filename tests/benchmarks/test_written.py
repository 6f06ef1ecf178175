"""Pages that scripts write from stored results are what the scripts write today."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).parents[2]


def load(name: str) -> ModuleType:
    path = ROOT / "benchmarks" / name
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_of_trust_is_fresh() -> None:
    """Else: python benchmarks/trust/trust_page.py"""
    page = load("trust/trust_page.py").page(ROOT / "results/trust")
    assert page == (ROOT / "docs/trust.md").read_text()


def test_a_break_that_survived_is_named() -> None:
    breaks = [
        {
            "file": "mpdt/a.py",
            "old": "x <\n y",
            "new": "x",
            "outcome": "noticed",
            "by": "tests/t.py::t",
        },
        {"file": "mpdt/a.py", "old": "z", "new": "", "outcome": "survived", "by": ""},
    ]
    text = load("trust/trust_page.py").mutants({"breaks": breaks, "seconds": 90})
    assert "| `mpdt` | 1 | 2 | 1 |" in text and "1 survived" in text
    assert "- `a.py` `` x < y `` became `` x ``: t.py::t" in text
    assert "- `a.py` `` z `` left out: survived" in text
