"""Cells in processes of their own and on a Ray cluster: the numbers of one after another."""

import io
import json
import multiprocessing
import os
import re
import signal
import time

import pytest

from mpdt.errors import SimulatorError, UsageError
from mpdt.train.cli import main
from mpdt.train.run.progress import Progress
from mpdt.train.run.stop import Stopped, StopRequest
from mpdt.train.study import apart, plans
from mpdt.train.study.apart import Engine, run_apart, run_cells, run_on_ray
from mpdt.train.study.live import Live
from mpdt.train.study.study import Places, run_study
from tests.train.study.test_study import ABSENT, BROKEN, ONE, TWO


class Told(Live):
    """Keeps what was said; `act` is called with the process that a cell has just got."""

    def __init__(self, act=lambda name, pid: None):
        super().__init__(stream=io.StringIO())
        self.act, self.lines = act, []

    def say(self, line):
        self.lines.append(line)
        if found := re.fullmatch(r"(\S+) begins, process (\d+)", line):
            self.act(found[1], int(found[2]))


@pytest.fixture
def places(tiny_file, tmp_path):
    return Places(tiny_file.parent, tmp_path / "runs", tmp_path / "results")


def scores(places, cell):
    return json.loads(places.result(cell).read_text())["scores"]


def one_after_another(cells, places, tmp_path):
    alone = Places(places.data, tmp_path / "alone/runs", tmp_path / "alone/results")
    assert {one.state for one in run_study(cells, alone, Progress(quiet=True))} == {"done"}
    return {cell.name: scores(alone, cell) for cell in cells}


@pytest.mark.long
def test_a_killed_process_fails_its_own_cell_and_the_others_go_on(places, tmp_path):
    def kill(name, pid):
        if name == ONE.name:
            os.kill(pid, signal.SIGKILL)

    said = Told(kill)
    found = {
        one.cell.name: one
        for one in run_apart([ONE, ABSENT, TWO], places, StopRequest(), said, workers=2)
    }
    assert any(line.startswith(f"{TWO.name}  written to ") for line in said.lines)
    assert {name: one.state for name, one in found.items()} == {
        ONE.name: "failed", ABSENT.name: "no data", TWO.name: "done"
    }  # fmt: skip
    assert "SIGKILL (memory usually); the same command goes on" in found[ONE.name].note
    assert {TWO.name: scores(places, TWO)} == one_after_another([TWO], places, tmp_path)
    again = run_apart([TWO], places, StopRequest(), told := Told(), workers=2)
    assert [one.state for one in again] == ["done"]
    assert not told.lines  # nothing is begun for what is done


def test_what_a_cell_says_reaches_the_parent(places):
    """Its error with the hint too, and where it is."""
    sent = []
    telling = apart._Telling(BROKEN.name, sent.append, StopRequest())
    assert apart._outcome(BROKEN, places, False, telling).state == "failed"
    said = [one.text for one in sent if isinstance(one, apart._Said)]
    assert any(line.startswith(f"{BROKEN.name}  error: ") for line in said)
    assert any(line.startswith(f"{BROKEN.name}  hint: ") for line in said)
    board = apart._Board()
    for one in [*sent, "student 1/2"]:
        board.put("a", one)
    assert board.read(0) == ({"a": "student 1/2"}, said)
    assert board.read(len(said)) == ({"a": "student 1/2"}, [])


def test_a_signal_ends_every_process(places):
    stop, pids = StopRequest(), []

    def ask(name, pid):
        pids.append(pid)
        stop.signal_number = signal.SIGTERM

    with pytest.raises(Stopped):
        list(run_apart([ONE, TWO], places, stop, Told(ask), workers=2))
    assert len(pids) == 2 and not places.results.exists(), "none ran to its end"
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_a_cell_that_is_asked_to_stop_twice_saves_what_it_has(places, monkeypatch):
    """By the signal that its process group gets, and by its parent."""
    asked = []

    def outcome(cell, places, restart, progress):
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGTERM)
        asked.append(progress.stop.signal_number)  # the update ends, and then is saved
        progress.stop.check()

    monkeypatch.setattr(apart, "_outcome", outcome)
    monkeypatch.setattr(apart, "end_with_parent", lambda: None)
    apart._work(multiprocessing.Pipe()[0], ONE, places, False)
    assert asked == [signal.SIGTERM]


def test_what_a_stopped_restart_says_makes_the_other_cells_again(places, monkeypatch, capsys):
    """Without --restart they count as done."""

    def stopped(*_):
        raise Stopped(signal.SIGINT)

    words = ["study", "try", "--data-dir", str(places.data), "--restart"]
    monkeypatch.setattr(plans, "STUDIES", {"try": (ONE, TWO)})
    monkeypatch.setattr(apart, "run_cells", stopped)
    monkeypatch.setattr("sys.argv", ["mpdt-train", *words])
    with pytest.raises(SystemExit):
        main()
    told = capsys.readouterr().err
    assert f"mpdt-train {' '.join(words)}" in told
    assert "saved" not in told and "keep their results" in told


def test_several_at_once_are_asked_for_on_the_command_line(places, monkeypatch, capsys):
    monkeypatch.setattr(plans, "STUDIES", {"try": (ABSENT,)})
    with pytest.raises(SystemExit) as left:
        main(["study", "try", "--data-dir", str(places.data), "--workers", "2"])
    assert not left.value.code
    assert "no data" in capsys.readouterr().out
    for words, found in ((["--workers", "0"], "--workers"), (["--address", "auto"], "--address")):
        with pytest.raises(SystemExit) as left:
            main(["study", "try", *words])
        assert left.value.code == 2
        assert f"error: {found}: " in capsys.readouterr().err


def test_engines_that_make_no_sense():
    with pytest.raises(UsageError, match="no cell could run"):
        Engine(workers=0)
    with pytest.raises(UsageError, match="without a cluster"):
        Engine(address="auto")


def test_lines_of_several_cells_are_told_where_they_changed(monkeypatch):
    live = Live(stream=io.StringIO())
    monkeypatch.setattr(live._pace, "is_time", lambda: True)
    live.show({"a": "student 1/9", "longer": "test 2/9"})
    live.show({"a": "student 1/9", "longer": "test 3/9"})
    assert live._stream.getvalue().splitlines() == [
        "a       student 1/9", "longer  test 2/9", "longer  test 3/9"
    ]  # fmt: skip
    quiet = Live(quiet=True, stream=io.StringIO())
    quiet.say("x")
    quiet.show({"a": "b"})
    assert not quiet._stream.getvalue()


def test_a_cluster_that_does_not_answer_is_one_error_in_seconds(places):
    pytest.importorskip("ray")
    began = time.monotonic()
    engine = Engine("ray", address="127.0.0.1:9")
    with pytest.raises(SimulatorError, match="no Ray cluster answers"):
        list(run_cells([TWO], places, engine, StopRequest(), quiet=True))
    assert time.monotonic() - began < 60


@pytest.mark.slow
def test_a_cluster_that_loses_a_node(places, tmp_path):
    """Two nodes, the one that has begun is killed; the scores are those of one after another."""
    cluster_utils = pytest.importorskip("ray.cluster_utils")
    cluster = cluster_utils.Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
    try:
        cells, found = [ONE, TWO], []
        killed = []

        class Killing(Told):
            def show(self, lines):
                if places.runs.exists() and not killed:
                    killed.append([path.name for path in places.runs.iterdir()])
                    cluster.remove_node(nodes[1], allow_graceful=False)

        for one in run_on_ray(cells, places, StopRequest(), Killing(), address=cluster.address):
            found.append(one)
        assert {one.cell.name: (one.state, one.note) for one in found} == {
            cell.name: ("done", "") for cell in cells
        }  # fmt: skip
        assert killed
        assert {c.name: scores(places, c) for c in cells} == one_after_another(
            cells, places, tmp_path
        )
    finally:
        cluster.shutdown()
