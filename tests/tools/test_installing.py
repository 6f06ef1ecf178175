"""What others build on: the lowest versions, the workflow's targets, types that are shipped."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement

from mpdt.data.verbs.needs import DEVELOPERS

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def asked() -> list[Requirement]:
    """Of mpdt and of its extras for users."""
    project: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    texts = [*project["dependencies"], *(text for name, found in extras.items()
                                         if name not in DEVELOPERS for text in found)]  # fmt: skip
    return [Requirement(text) for text in texts]


def test_the_lowest_versions_are_those_that_pyproject_allows(asked: list[Requirement]) -> None:
    lines = (ROOT / "constraints-lowest.txt").read_text().splitlines()
    lowest = dict(line.lower().replace("_", "-").split("==") for line in lines if "==" in line)
    for one in asked:
        (bound,) = one.specifier
        found = lowest[one.name.lower().replace("_", "-")]
        # 3.1 and 3.1.0 are one version; a pin is its own lowest.
        assert re.sub(r"(\.0)+$", "", found) == re.sub(r"(\.0)+$", "", bound.version), one


def test_the_tests_fit_beside_the_lowest_versions(asked: list[Requirement]) -> None:
    """One version of each in constraints.txt that the ranges allow."""
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    tested = dict(line.split("==") for line in lines if "==" in line and not line.startswith("#"))
    tested = {
        name.lower().replace("_", "-"): version.split()[0] for name, version in tested.items()
    }
    for one in asked:
        version = tested.get(one.name.lower().replace("_", "-"))
        assert version is None or one.specifier.contains(version), one


def test_the_workflow_calls_what_there_is() -> None:
    text = (ROOT / ".github/workflows/checks.yml").read_text()
    jobs = yaml.safe_load(text)["jobs"]
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    called = re.findall(r"make (\w+)", text)
    assert set(called) <= targets and {"site", "slow", "lowest"} <= set(called)
    assert any("bash .ci/run" in str(step) for step in jobs["change"]["steps"])
    assert (ROOT / ".ci/run").exists()


def test_types_are_shipped() -> None:
    assert (ROOT / "mpdt/py.typed").exists()  # tools/wheel.py checks a stranger's code with it
