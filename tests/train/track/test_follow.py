"""Following: every line that stays comes to a tracker once, whatever was killed in between."""

import json
from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest

from mpdt.errors import UsageError
from mpdt.train.run.folder import RunFolder
from mpdt.train.run.progress import Progress
from mpdt.train.track import follow, tracker
from mpdt.train.track.follow import Following
from mpdt.train.track.points import point_of
from mpdt.train.track.tracker import chosen_trackers

from ..run.command import QUICK, call

SHORT = ["-q", "--method", "MPDT-no-distillation", "--multitask.steps", "6", "--evaluation.blocks",
         "test", "--multitask.log-every", "1", "--multitask.checkpoint-every", "2",
         "--evaluation.episodes", "1"]  # fmt: skip


@dataclass
class Memory:
    """A tracker that outlives processes; the next delivery may be killed after some points."""

    points: list = field(default_factory=list)
    begun: int = 0
    dies_after: int | None = None
    every_s: float = 0.0
    breaks: bool = False

    def held(self):
        return self.points[-1].number + 1 if self.points else 0

    def deliver(self, points):
        if self.breaks and points:
            raise OSError("no network")
        self.begun += not points
        whole, self.dies_after = self.dies_after, None if points else self.dies_after
        if points and whole is not None:
            self.points += points[:whole]
            raise KeyboardInterrupt
        self.points += points


@pytest.fixture
def memory(monkeypatch):
    kept = Memory()
    monkeypatch.setattr(follow, "open_tracker", lambda name, folder, facts: kept)
    monkeypatch.setattr(tracker, "find_spec", lambda name: True)
    return kept


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(follow, "_facts", lambda *of: None)
    monkeypatch.setattr(follow, "scores_in", lambda results: [], raising=False)
    monkeypatch.setattr(follow, "prompt_maps", lambda weights: {})
    return RunFolder(tmp_path)


def follower(folder, names=("tensorboard",)):
    material = SimpleNamespace(
        test_rows=(1,), dataset=SimpleNamespace(tasks=SimpleNamespace(names=("a", "b")))
    )
    made = Following(names, Progress(quiet=True))
    made.begin(folder, SimpleNamespace(material=material))
    return made


def write(folder, *steps, phase="student"):
    for step in steps:
        folder.log.append({"phase": phase, "step": step, "loss": float(step)})
    return folder.log.size_bytes


def judgement(name):
    return {"identity": {"judging": name * 16}, "scores": [], "updates": {"student": 9}}


def told(memory):
    return [(p.number, p.at, *p.scalars) for p in memory.points]


def test_lines_behind_a_checkpoint_wait(folder, memory):
    one = follower(folder)
    kept = write(folder, 1, 2)
    write(folder, 3)
    one.kept(kept)
    assert [p.at for p in memory.points] == [1, 2]
    folder.log.cut(kept)  # a resumed run writes other lines there
    one.kept(write(folder, 30, 40))
    assert [(p.number, p.at) for p in memory.points] == [(0, 1), (1, 2), (2, 30), (3, 40)]


@pytest.mark.parametrize("arrived", [0, 1, 2])
def test_a_delivery_that_was_killed_is_finished_by_the_next_process(folder, memory, arrived):
    kept = write(folder, 1, 2)
    memory.dies_after = arrived
    with pytest.raises(KeyboardInterrupt):
        follower(folder).kept(kept)
    follower(folder).kept(write(folder, 3))
    assert [p.at for p in memory.points] == [1, 2, 3]
    assert [p.number for p in memory.points] == [0, 1, 2]


@pytest.mark.parametrize("arrived", [None, 0, 1, 2])
def test_each_judgement_comes_once_and_later_ones_below_a_name(folder, memory, arrived):
    trained = write(folder, 1)
    one = follower(folder)
    one.kept(trained)
    write(folder, 7, phase="adapt")
    memory.dies_after = arrived
    if arrived is None:
        one.judged(judgement("a"))
    else:
        with pytest.raises(KeyboardInterrupt):
            one.judged(judgement("a"))
        one = follower(folder)
        one.kept(trained)
        one.judged(judgement("a"))
    one.judged(judgement("a"))
    assert told(memory) == [(0, 1, "student/loss"), (1, 7, "adapt/loss"), (2, 9)]
    folder.log.cut(trained)
    write(folder, 8, phase="adapt")
    one.judged(judgement("b"))
    assert told(memory)[3:] == [(3, 8, "judged bbbbbbbb/adapt/loss"), (4, 9)]
    one.judged(judgement("a"))
    assert len(memory.points) == 5


def test_a_tracker_that_breaks_ends_no_run_and_catches_up(folder, memory, capsys):
    one = follower(folder)
    one.progress = Progress()
    memory.breaks = True
    one.kept(write(folder, 1))
    assert "tensorboard failed, and is left alone: OSError: no network" in capsys.readouterr().err
    memory.breaks = False
    one.kept(write(folder, 2))
    assert memory.points == []
    follower(folder).kept(folder.log.size_bytes)
    assert [p.at for p in memory.points] == [1, 2]


def test_a_line_as_a_point():
    record = {"phase": "adapt", "start": "cross", "step": 3, "losses": [1.0, 3.0], "sure": True}
    found = point_of(record, 5, ["left", "right"])
    assert (found.number, found.at, found.texts) == (5, 3, {"adapt cross/sure": "true"})
    assert found.scalars == {
        "adapt cross/losses mean": 2.0, "adapt cross/losses left": 1.0,
        "adapt cross/losses right": 3.0,
    }  # fmt: skip
    inferred = point_of({"phase": "infer", "task": "v1", "weights": {"a": 1.0}, "error": 0.5}, 0)
    assert inferred.scalars == {"infer/error v1": 0.5}
    assert inferred.texts == {"infer/weights v1": '{"a": 1.0}'}
    assert point_of({"phase": "x", "loss": float("nan")}, 0).scalars == {}


@pytest.mark.parametrize(
    ("text", "said"),
    [("tensorbord", "did you mean 'tensorboard'"), (",", "no tracker named"),
     ("wandb", "wandb is not installed; pip")],
)  # fmt: skip
def test_trackers_that_cannot_be_had(text, said, monkeypatch):
    monkeypatch.setattr(tracker, "find_spec", lambda name: None)
    with pytest.raises(UsageError) as caught:
        chosen_trackers(text)
    assert all(part in caught.value.render() for part in said.split("; "))


def test_a_killed_and_resumed_run_tells_each_of_its_lines(tiny_file, tmp_path, memory, monkeypatch):
    """Killed in the middle of a delivery; then twice the same command."""
    arguments = ["--data", tiny_file, *QUICK, *SHORT, "--log", "trackio", "--runs-dir", tmp_path]
    with monkeypatch.context() as patched:

        def deliver(points):
            memory.points += points[:1] if memory.points else points
            if points and points[0].number:
                raise KeyboardInterrupt

        patched.setattr(memory, "deliver", deliver)
        with pytest.raises(KeyboardInterrupt):
            call(*arguments, "--name", "r")
    assert [p.number for p in memory.points] == [0, 1, 2]  # a half of the second delivery
    for _ in range(2):
        assert call(*arguments, "--name", "r") == 0
        lines = (tmp_path / "r/metrics.jsonl").read_text().splitlines()
        *told, last = memory.points
        assert [p.number for p in memory.points] == list(range(len(lines) + 1))
        for point, line in zip(told, map(json.loads, lines), strict=True):
            assert point.at == line["step"]
            assert point.scalars.get("student/loss") == line.get("loss")
    assert "test mean return/MPDT-no-distillation from cross, adapted" in last.scalars
    assert set(last.images) == {"prompts/P_c", "prompts/P_0", "prompts/P_1"}
    assert json.loads((tmp_path / "r/tracked.json").read_text())["run"]
