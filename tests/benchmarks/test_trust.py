"""Small versions of `make trust`: a few kills and a little damage, with the scripts themselves."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]


def run(script: str, target: Path, *options: str) -> Any:
    path = str(ROOT / "benchmarks/trust" / script)
    command = [sys.executable, path, "--json", str(target), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return json.loads(target.read_text())


@pytest.mark.long
def test_three_kills(tmp_path: Path) -> None:
    found = run("torture.py", tmp_path / "x.json", "--kills", "3", "--seed", "2", "--size", "0.1")
    assert found["kills"] == 3
    assert found["finished files compared"] >= 1


@pytest.mark.long
def test_a_handful_of_writers_that_meet(tmp_path: Path) -> None:
    found = run("writers.py", tmp_path / "x.json", "--pairs", "6", "--seed", "1", "--no-training")
    assert found["pairs"] == 6
    assert found["destroyed"] == found["unkept"] == found["both failed"] == found["wrong"] == 0
    assert found["exit 0"] >= 6


@pytest.mark.long
def test_a_little_damage(tmp_path: Path) -> None:
    found = run("fuzz.py", tmp_path / "x.json", "--flips", "10", "--mutations", "35")
    counts = [sum(row.values()) for name, row in found.items() if name != "seed"]
    assert sum(counts) == 45
    assert len(counts) == 6, "flips, and files of five kinds"
    assert "found" in found["mutations of weights"]


@pytest.mark.long
def test_every_small_input_that_announces_much(tmp_path: Path) -> None:
    rows = run("limits.py", tmp_path / "x.json", "--forked")
    assert len(rows) > 20 and not [row for row in rows if row["faults"]]
    declared = next(row for row in rows if "20,000,000" in row["input"])
    assert declared["megabytes"] < 300 and "none" in declared["error"]


@pytest.mark.slow  # `make trust` does more of them
def test_two_hundred_changes_of_texts(tmp_path: Path) -> None:
    found = run("texts.py", tmp_path / "x.json", "--light", "--mutations", "200", "--seed", "4")
    counts = found["texts"]
    assert sum(sum(row.values()) for row in counts.values()) == found["mutations"] == 200
    assert len(counts) >= 20 and all(set(row) <= {"error", "read"} for row in counts.values())
    assert sum(row.get("error", 0) for row in counts.values()) > 60, "most changes are refused"
