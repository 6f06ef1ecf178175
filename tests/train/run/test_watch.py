"""What `mpdt-train watch` says of a run that trains, stands still, is judged or is done."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mpdt.disk import holding
from mpdt.disk.holder import writer_of
from mpdt.errors import MissingFileError
from mpdt.train.run.config import to_plain
from mpdt.train.run.folder import FORMAT, RunFolder
from mpdt.train.run.presets import get_preset
from mpdt.train.run.watch import Rate, bars, facts, lines, look, watch


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """A folder as a run of 20 and 20 updates has it before its first line."""
    folder = RunFolder(tmp_path / "run")
    folder.path.mkdir()
    training = {**to_plain(get_preset("smoke")), "data": {"slice": None}}
    stored = {"format": FORMAT, "training": training, "judging": {"data": {}}}
    folder.config.write_text(json.dumps(stored))
    return folder


def log(run: RunFolder, phase: str, step: int, loss: float) -> None:
    run.log.append({"phase": phase, "step": step, "action_loss": loss})


@contextmanager
def at_work(run: RunFolder) -> Iterator[None]:
    with holding(run.path, amends=True):
        yield


def test_a_run_is_told_by_who_holds_its_folder_and_what_lies_there(run: RunFolder) -> None:
    assert look(run.path).state == "stopped" and writer_of(run.path) is None
    with at_work(run):
        seen = look(run.path)
        assert seen.state == "training" and seen.writer is not None
        run.weights.write_bytes(b"")
        assert look(run.path).state == "judging"
    assert writer_of(run.path) is None


def test_a_lock_that_a_kill_left_is_nobody(run: RunFolder) -> None:
    with at_work(run):
        lock = run.path.with_name(f".{run.path.name}.lock")
        left = json.loads(lock.read_text())
    lock.write_text(json.dumps(left | {"start": "1"}) + "\n")  # another process has the id by now
    assert writer_of(run.path) is None and look(run.path).state == "stopped"
    lock.write_text("no lock of ours")
    assert writer_of(run.path) is None


def test_the_phase_goes_on_when_the_first_is_done(run: RunFolder) -> None:
    assert (look(run.path).phase, look(run.path).asked) == (
        "teacher",
        {"teacher": 20, "student": 20},
    )
    log(run, "teacher", 10, 0.5)
    assert look(run.path).phase == "teacher"
    log(run, "teacher", 20, 0.4)
    assert look(run.path).phase == "student"
    log(run, "student", 5, 0.3)
    run.log.append({"phase": "infer", "task": "a", "weights": {}})  # not of training
    with at_work(run):
        text = "\n".join(lines(look(run.path), 75.4))
        assert "teacher          20/20   done" in text
        assert "student           5/20   0:01:15 left" in text
        assert "action loss  0.4000   █▁   teacher" in text
        assert "left: not known yet" in "\n".join(lines(look(run.path), None))
    told = facts(look(run.path))
    assert told["state"] == "stopped" and told["returns"] == []
    assert told["phases"]["student"] == {"done": 5, "asked": 20, "action_loss": 0.3}


def test_a_teacher_cut_short_by_a_time_limit_is_over(run: RunFolder) -> None:
    log(run, "teacher", 10, 0.5)
    log(run, "student", 5, 0.3)
    assert look(run.path).phase == "student"


def test_what_is_left_is_reckoned_from_lines_that_came_while_watching() -> None:
    rate = Rate()
    assert rate.left_s("a", 50, 300, 0.0) is None  # was there before
    assert rate.left_s("a", 100, 300, 7.0) is None  # the clock begins
    assert rate.left_s("a", 100, 300, 8.0) is None
    # 50 updates in 10 s, 150 are left, and 4 of those seconds are over
    assert rate.left_s("a", 150, 300, 17.0) == pytest.approx(30.0)
    assert rate.left_s("a", 150, 300, 21.0) == pytest.approx(26.0)
    assert rate.left_s("a", 150, 300, 99.0) == 0.0
    assert rate.left_s("a", 200, 300, 107.0) == pytest.approx(100.0)  # 100 updates in 100 s
    assert rate.left_s("b", 50, 300, 100.0) is None  # a phase of its own
    rate.left_s("b", 100, 300, 110.0)
    assert rate.left_s("b", 50, 300, 120.0) is None  # resumed from before


def test_bars_show_the_last_forty_between_least_and_greatest() -> None:
    assert bars([3.0, 1.0, 2.0]) == "█▁▅" and bars([1.0]) == "▁"
    assert len(bars([0.0] * 99)) == 40


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_follows_until_nobody_is_at_work(
    run: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each sleep is the run's next move; the last one ends it."""
    moves: list[Callable[[], object]] = [
        lambda: log(run, "teacher", 20, 0.4),
        lambda: log(run, "student", 10, 0.25),
        lambda: working.__exit__(None, None, None),
    ]
    terminal, working = Terminal(), at_work(run)
    working.__enter__()
    monkeypatch.setattr(time, "sleep", lambda _: moves.pop(0)())
    assert watch(run.path, once=False, as_json=False, stream=terminal) == 0
    shown = terminal.getvalue()
    assert shown.index("teacher           0/20") < shown.index("student          10/20")
    assert not moves and "nobody is at work here" in shown
    assert "\x1b[?25h" in shown  # the cursor is back


def test_leaving_a_terminal_leaves_the_run(run: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    def leave(_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(time, "sleep", leave)
    with at_work(run):
        assert watch(run.path, once=False, as_json=False, stream=Terminal()) == 130
        assert look(run.path).state == "training"


def test_one_look_does_not_wait(run: RunFolder) -> None:
    for once, stream in ((True, Terminal()), (False, io.StringIO())):
        with at_work(run):
            assert watch(run.path, once, as_json=False, stream=stream) == 0
        assert "training" in stream.getvalue()
    with pytest.raises(MissingFileError, match="no run here"):
        watch(run.path.parent, once=True, as_json=False)
