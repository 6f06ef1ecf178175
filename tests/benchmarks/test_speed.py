"""Benchmarks of speed: their page and picture are fresh, and who is judged by which target."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
SPEED = ROOT / "benchmarks" / "speed"
Load = Callable[[str], ModuleType]


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch) -> Iterator[Load]:
    """Scripts import their neighbours by name; afterwards nobody else finds those."""
    monkeypatch.syspath_prepend(str(SPEED))
    yield importlib.import_module
    for path in SPEED.glob("*.py"):
        sys.modules.pop(path.stem, None)


def test_the_page_is_fresh(load: Load) -> None:
    """Else: python benchmarks/speed/performance_page.py"""
    page = load("performance_page").page()
    assert page == (ROOT / "docs/performance.md").read_text()


def test_the_picture_is_fresh(load: Load, tmp_path: Path) -> None:
    """Else: python benchmarks/speed/performance_page.py"""
    stored = load("performance_page").stored()
    load("performance_picture").draw(tmp_path / "x.svg", stored)
    assert (tmp_path / "x.svg").read_text() == (ROOT / "docs/performance.svg").read_text()


def test_what_is_known_about_misses_is_about_paths_that_are_measured(load: Load) -> None:
    module = load("performance_page")
    assert set(module.KNOWN) <= set(module.PATHS)
    assert all(set(said) <= {"in_the_way", "next_factor_of_two"} for said in module.KNOWN.values())


def a_record(measured: float, met: bool) -> dict[str, Any]:
    target = {"way": "b", "least": 2.0, "only": "bfloat16", "measured": measured, "met": met}
    rows = [
        {"name": "a", "kind": "ours", "rate": 4.0, "spread": 0.2, "ours_over_this": 1.0},
        {"name": "b", "kind": "peer", "rate": 4.0 / measured, "ours_over_this": measured},
    ]
    case = {"case": "x", "unit": "y/s", "rounds": 3, "rows": rows, "targets": [target], "note": ""}
    return {"cases": [case], "facts": []}


def test_a_target_says_for_which_machines_it_holds(load: Load) -> None:
    page = load("performance_page")
    assert page.verdicts(a_record(3.0, True)) == [["x", ">= 2 x b", "bfloat16", "3.00", "met"]]
    assert "| ours: a | 4 | 10% | 1.00 x |" in page.section("x", "X", a_record(3.0, True))


def test_a_missed_target_may_not_stand_without_its_limit(load: Load) -> None:
    page = load("performance_page")
    with pytest.raises(SystemExit, match="nowhere misses a target"):
        page.section("nowhere", "X", a_record(1.0, False))


def test_a_busy_machine_is_not_judged(
    load: Load,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    rounds = load("rounds")
    folders = {name: tmp_path / name for name in ("RESULTS", "BUSY")}
    for name, folder in folders.items():
        monkeypatch.setattr(rounds, name, folder)
    for idle in (True, False):
        report = rounds.Report("x", 1, rounds._is_idle(0.02 if idle else 0.3, "now"))
        report.fact("size", 1.0, "m", least=2.0)
        kept = report.write(1.0, 0.02)
        assert kept.parent == folders["RESULTS" if idle else "BUSY"]
        assert json.loads(kept.read_text())["judged"] is idle
        said = capsys.readouterr().out
        assert ("MISSED" in said) is idle and ("others used 30%" in said) is not idle


def test_targets_of_another_class_of_machine_are_left_out(load: Load) -> None:
    rounds = load("rounds")
    report = rounds.Report("x", 1)
    for has, wanted in ((True, ["", "bfloat16"]), (False, ["", "no bfloat16"])):
        report._has_bfloat16 = has
        targets = [rounds.Target("b", 1.0, only) for only in ("", "bfloat16", "no bfloat16")]
        ways = [rounds.Way(name, "ours", lambda: None, 1.0) for name in "ab"]
        report.compare("case", "1/s", ways, targets)
        assert [target["only"] for target in report.cases[-1]["targets"]] == wanted


def test_what_others_use_is_told_from_what_the_script_and_its_children_do(load: Load) -> None:
    machine = load("machine")
    watch = machine.Watch()
    before = machine._own_s()
    # The kernel tells processor time in whole ticks of each kind: a little more than is asked.
    code = "import time\nwhile time.process_time() < 0.4: pass"
    with subprocess.Popen([sys.executable, "-c", code]) as process:
        process.wait()
        assert machine._own_s() - before >= 0.3
    share = watch.others()
    assert share is None or 0.0 <= share <= 1.5


def test_the_limit_of_collecting_plays_the_same_episodes(load: Load) -> None:
    """Open loop it ends in the states that were collected; other actions end elsewhere."""
    collecting = load("collecting")
    job, block = collecting.block_of("cheetah_dir", "episodes", "random")
    block = replace(block, rows=2)
    from mpdt.data.collect.parts import PartsFolder
    from mpdt.data.collect.runner import BlockRunner

    episodes = BlockRunner(job, PartsFolder(Path("x.h5"))).simulate(block)
    assert collecting.native(job.plan, block, episodes)() == 400
    other = replace(episodes[1], actions=episodes[0].actions)
    with pytest.raises(AssertionError):
        collecting.native(job.plan, block, [episodes[0], other])()
