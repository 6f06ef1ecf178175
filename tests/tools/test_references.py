"""The references and the frozen list of options are what the code says; `make docs` writes them."""

from __future__ import annotations

import importlib.util
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
REFRESH = "python tools/write_reference.py (or make docs) writes it anew; look at what changed"


@cache
def references() -> ModuleType:
    spec = importlib.util.spec_from_file_location("references", ROOT / "tools/write_reference.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def pages() -> dict[Path, str]:
    found: dict[Path, str] = references().pages()
    return found


def test_the_options_are_frozen() -> None:
    path = ROOT / "tests/golden/options.txt"
    found, kept = pages()[path].splitlines(), path.read_text().splitlines()
    changed = [f"+ {line}" for line in found if line not in kept]
    changed += [f"- {line}" for line in kept if line not in found]
    assert found == kept, "\n".join([f"{path.name}: {REFRESH}", *changed])


@pytest.mark.parametrize("name", ["cli.md", "api.md"])
def test_a_reference_is_fresh(name: str) -> None:
    path = ROOT / "docs/reference" / name
    assert pages()[path] == path.read_text(), f"{path.name}: {REFRESH}"


def test_an_option_is_read_as_it_is_typed() -> None:
    from mpdt.data.cli import CONFIG
    from mpdt.data.verbs.remote import Push

    found = {one.words: (one.default, one.help) for one in references().options(Push, CONFIG)}
    assert found["URL"][0] == "required"
    assert found["--replace"] == ("default: False", "Also if something else is there.")
    assert list(found)[:2] == ["FILE|FOLDER", "URL"]
