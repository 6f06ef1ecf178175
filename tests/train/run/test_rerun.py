"""The same folder again: judged anew, continued, refused, or busy; adapted without training."""

import json
import os
import shutil
import threading
from types import SimpleNamespace

import pytest

from mpdt.disk.holder import Holder
from mpdt.errors import TrainingError
from mpdt.train.fit.data import load_material
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.folder import RunFolder, claimed, locate
from mpdt.train.run.prepare import prepare
from mpdt.train.run.spent import Spent

from .command import QUICK, call, names_in


def results_of(folder):
    return json.loads((folder / "results.json").read_text())


@pytest.fixture(scope="module")
def finished(tiny_file, tmp_path_factory):
    runs = tmp_path_factory.mktemp("runs")
    assert call("--data", tiny_file, *QUICK, "--runs-dir", runs, "--name", "r", "-q") == 0
    return runs / "r"


@pytest.fixture
def again(tiny_file, finished, tmp_path):
    """A copy of the finished run, and the arguments that made it."""
    shutil.copytree(finished, tmp_path / "r")
    return tmp_path / "r", ["--data", tiny_file, *QUICK, "--runs-dir", tmp_path, "--name", "r"]


@pytest.mark.parametrize(
    "changes",
    [["--adapt.steps", "3"], ["--evaluation.episodes", "1"], ["--statistics.axes", "position"]],
)
def test_other_judging_takes_the_same_weights(again, finished, capsys, changes):
    folder, arguments = again
    before = (folder / "weights.safetensors").stat().st_mtime_ns
    assert call(*arguments, *changes) == 0
    error = capsys.readouterr().err
    assert "trained already" in error and "student" not in error.replace("student 20 of", "")
    assert (folder / "weights.safetensors").stat().st_mtime_ns == before
    new, old = results_of(folder), results_of(finished)
    assert (
        new["config"] != old["config"] and new["identity"]["judging"] != old["identity"]["judging"]
    )
    assert new["identity"]["training"] == old["identity"]["training"]
    assert (new["updates"], new["complete"]) == (old["updates"], True)
    part, _, key = changes[0].removeprefix("--").partition(".")
    stored = json.loads((folder / "config.json").read_text())
    assert str(stored["judging"][part][key]) == changes[1]


def test_judged_anew_is_judged_as_at_first(again, finished, capsys):
    """There and back: the weights on disk are all that judging depends on."""
    folder, arguments = again
    assert call(*arguments, "--adapt.steps", 3, "-q") == 0
    shutil.rmtree(folder / "judged")
    for phase in ("teacher", "student", "best"):  # killed before the checkpoints went
        (folder / f"checkpoint-{phase}.safetensors").write_bytes(b"old")
    assert call(*arguments) == 0
    assert "trained already" in capsys.readouterr().err
    assert results_of(folder)["scores"] == results_of(finished)["scores"]
    for name in ("metrics.jsonl", "report.md"):
        assert (folder / name).read_bytes() == (finished / name).read_bytes(), name
    shutil.rmtree(folder / "judged")
    assert names_in(folder) == names_in(finished)


def test_an_earlier_judgement_is_kept_until_it_is_made_again(again, finished):
    folder, arguments = again
    assert call(*arguments, "--adapt.steps", 3, "-q") == 0
    (kept,) = (folder / "judged").iterdir()
    assert kept.read_bytes() == (finished / "results.json").read_bytes()
    other = (folder / "results.json").read_bytes()
    assert call(*arguments, "-q") == 0
    (kept,) = (folder / "judged").iterdir()
    assert kept.read_bytes() == other


def test_a_finished_run_is_swept(again, capsys):
    """A process was killed between its last file and the end of its hold."""
    folder, arguments = again
    other = Holder.me()
    (folder.parent / ".r.lock").write_bytes(other.encoded())
    twice = RunFolder(folder).judged(results_of(folder)["identity"]["judging"])
    twice.parent.mkdir()
    twice.write_bytes((folder / "results.json").read_bytes())
    (folder / f".results.json.{other.token}.tmp").write_text("half")
    assert call(*arguments) == 0
    assert "this run is done" in capsys.readouterr().err
    assert {path.name for path in folder.parent.iterdir()} == {"r"}
    assert not list(folder.glob(".*")) and not twice.exists()


class Pair:
    """The second of two processes; the first one says that the run is done."""

    rank, size, left = 1, 2, False

    def any(self, flags):
        return [True for _ in flags]

    def leave(self):
        self.left = True


def test_a_finished_run_ends_every_process(again, monkeypatch):
    from mpdt.train.run import pipeline
    from mpdt.train.run.folder import RunFolder
    from mpdt.train.run.progress import Progress

    folder, arguments = again
    pair = Pair()
    monkeypatch.setattr(pipeline.Group, "join", lambda: pair)
    prepared = prepare(TrainConfig(), str(arguments[1]))
    found = pipeline.run_pipeline(prepared, RunFolder(folder.parent / "r"), Progress(True))
    assert found == {} and pair.left and not (folder.parent / "r.rank-1").exists()


def test_other_data_judge_anew_or_are_refused(again, finished, monkeypatch, capsys):
    """The same settings on a file whose presets, then whose statistics differ."""
    from dataclasses import replace

    _, arguments = again

    def load_with(change):
        def load(*args):
            material = load_material(*args)
            return replace(material, dataset=replace(material.dataset, **change(material.dataset)))

        monkeypatch.setattr("mpdt.train.run.prepare.load_material", load)

    def other_presets(dataset):
        x = dataset.tta["default"]
        return {"tta": {"default": replace(x, preset_return=x.preset_return + 9)}}

    def other_statistics(dataset):
        fields = dict(dataset.stats)
        fields["observations"] = {k: v + 1 for k, v in fields["observations"].items()}
        return {"stats_info": replace(dataset.stats_info, fields=fields)}

    load_with(other_presets)
    assert call(*arguments) == 0
    assert "trained already" in capsys.readouterr().err
    load_with(other_statistics)
    assert call(*arguments) == 1
    assert "found data.statistics " in capsys.readouterr().err


def test_a_damaged_table_is_judged_again(again, finished):
    folder, arguments = again
    (folder / "results.json").write_text("{half")
    assert call(*arguments, "-q") == 0
    assert results_of(folder)["scores"] == results_of(finished)["scores"]


def test_a_changed_depth_is_refused_as_another_run(again, capsys):
    folder, arguments = again
    before = names_in(folder)
    assert call(*arguments, "--backbone.depth", 1, "--adapt.steps", 3) == 1
    error = capsys.readouterr().err
    assert "found backbone.depth null -> 1\n" in error and "--name r-2" in error
    assert names_in(folder) == before


def test_restart_trains_anew(again, capsys):
    folder, arguments = again
    (folder / "old").mkdir()
    assert call(*arguments, "--seed", 1, "--restart") == 0
    assert "trained already" not in capsys.readouterr().err
    assert results_of(folder)["config"]["seed"] == 1 and not (folder / "old").exists()


def test_a_refused_restart_keeps_what_was_there(again):
    folder, arguments = again
    before = names_in(folder)
    assert call(*arguments, "--restart", "--adapt.layers", 9) == 2
    assert names_in(folder) == before


def test_a_time_limit_is_no_end(tiny_file, finished, tmp_path, capsys):
    """Cut after one update of each phase, then once more, then to the end of an unbroken run."""
    folder = tmp_path / "r"
    arguments = ["--data", tiny_file, *QUICK, "--runs-dir", tmp_path, "--name", "r"]
    assert call(*arguments, "--time-limit-s", "1e-9") == 0
    captured = capsys.readouterr()
    text = "teacher 1 of 20, student 1 of 20"
    assert f"training ended by --time-limit-s: {text}" in captured.err
    assert f"incomplete, ended by a time limit after updates: {text}" in captured.out
    results = results_of(folder)
    assert results["complete"] is False
    assert results["updates"] == {"teacher": 1, "student": 1}
    assert results["updates_asked"] == {"teacher": 20, "student": 20}
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    assert [(x["phase"], x["step"]) for x in lines[:2]] == [("teacher", 1), ("student", 1)]
    assert f"- updates: {text} (incomplete" in (folder / "report.md").read_text()
    assert {"checkpoint-teacher.safetensors", "checkpoint-student.safetensors"} <= {
        *names_in(folder)
    }
    assert call(*arguments, "--time-limit-s", "1e-9") == 0
    assert results_of(folder)["updates"] == {"teacher": 2, "student": 1}
    assert call(*arguments) == 0
    assert "resuming teacher after 2 of 20 updates" in capsys.readouterr().err
    assert names_in(folder) == names_in(finished), "checkpoints gone"
    for name in ("metrics.jsonl", "weights.safetensors", "teacher.safetensors", "report.md"):
        assert (folder / name).read_bytes() == (finished / name).read_bytes(), name
    whole = results_of(finished)
    apart = {"seconds": 0, "digest": ""}  # time, and what is computed from all
    assert whole | apart == results_of(folder) | apart
    assert whole["complete"] is True


def test_a_cut_student_keeps_its_teacher(tiny_file, finished, tmp_path, monkeypatch, capsys):
    """One second an update, 38 in all: the teacher's half ends behind its update 19, that is
    with its last one; the student is at update 19 when second 39 comes."""
    from mpdt.train.run import trainer as run

    folder, seconds = tmp_path / "r", iter(range(100))
    arguments = ["--data", tiny_file, *QUICK, "--runs-dir", tmp_path, "--name", "r"]
    with monkeypatch.context() as patch:
        patch.setattr(run, "time", SimpleNamespace(monotonic=lambda: next(seconds)))
        assert call(*arguments, "-q", "--evaluation.episodes", 1, "--time-limit-s", 38) == 0
    assert results_of(folder)["updates"] == {"teacher": 20, "student": 19}
    assert call(*arguments) == 0
    assert "resuming student after 19 of 20" in capsys.readouterr().err
    for name in ("metrics.jsonl", "teacher.safetensors", "weights.safetensors"):
        assert (folder / name).read_bytes() == (finished / name).read_bytes(), name


def test_a_second_process_is_refused_by_name(again, tiny_file, capsys):
    folder, arguments = again
    identity = prepare(TrainConfig(), str(tiny_file)).identity
    own = locate(folder.parent, "new")
    lock = folder.parent / ".new.lock"
    taken, done = threading.Event(), threading.Event()

    def hold():
        with claimed(own, identity, restart=False):
            taken.set()
            done.wait(60)

    # A thread of its own stands for a process of its own.
    other = threading.Thread(target=hold)
    other.start()
    try:
        assert taken.wait(60) and lock.exists()
        assert call(*arguments[:-1], "new", "--restart") == 4
        error = capsys.readouterr().err
        assert "another process writes it" in error and f"process {os.getpid()} on" in error
        assert f"kill {os.getpid()}`; training goes on from its checkpoint, a judgement" in error
        assert own.config.exists(), "--restart of the refused one removed nothing"
    finally:
        done.set()
        other.join()
    assert not lock.exists()


def test_a_stored_run_is_adapted_and_evaluated_without_training(again, tiny_file, capsys):
    """`adapt` judges the test tasks alone, `evaluate` all; both leave the weights as they were."""
    folder, _ = again
    before = (folder / "weights.safetensors").read_bytes()
    infer = ["--adapt.starts", "infer", "--adapt.infer.steps", 5]
    assert call("adapt", folder, "--data", tiny_file, *infer, "-q") == 0
    scores = results_of(folder)["scores"]
    assert {s["block"] for s in scores} == {"test"}
    assert [s["reads"] for s in scores if s["method"] == "MPDT infer"] == ["X+rewards"] * 3
    assert call("evaluate", folder, "--data", tiny_file, "--evaluation.episodes", 1, "-q") == 0
    assert {s["block"] for s in results_of(folder)["scores"]} == {"train", "test"}
    assert (folder / "weights.safetensors").read_bytes() == before


def test_adapting_refuses_other_training_and_what_is_no_run(again, tiny_file, tmp_path, capsys):
    folder, _ = again
    assert call("adapt", folder, "--data", tiny_file, "--prompts.length", 5) == 1
    error = capsys.readouterr().err
    assert "found prompts.length 4 -> 5" in error
    assert "mpdt-train --data FILE --name r-2 trains another" in error, "adapt has no --restart"
    assert call("evaluate", folder, "--data", tiny_file, "--method", "Prompt-DT") == 2
    assert "the method of a stored run is no setting" in capsys.readouterr().err
    assert call("adapt", tmp_path, "--data", tiny_file) == 2
    assert "no run here" in capsys.readouterr().err
    (folder / "weights.safetensors").unlink()
    assert call("evaluate", folder, "--data", tiny_file, "--evaluation.episodes", 1) == 2
    assert "no trained weights in this run" in capsys.readouterr().err


def test_a_refused_judgement_leaves_the_run_as_it_was(again, tiny_file, capsys):
    folder, _ = again
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    for where, settings in {
        "adapt.steps": ("--adapt.steps", 10**20), "adapt.lr": ("--adapt.lr", 1e39),
        "evaluation.seed": ("--evaluation.seed", 10**20), "windows": ("--adapt.windows", 10**9),
        "too few episodes": ("--adapt.episodes", 99), "blocks": ("--evaluation.blocks",),
    }.items():  # fmt: skip
        code = call("adapt", folder, "--data", tiny_file, "-q", *settings)
        error = capsys.readouterr().err
        assert code in (1, 2) and where in error and "Traceback" not in error
        assert {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()} == before


def test_a_judgement_that_fails_later_leaves_all_of_the_one_before(again, tiny_file, monkeypatch):
    """The next one starts from the settings that made the results; the log tells of them."""
    folder, _ = again
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    def fail(*_):
        raise TrainingError("nothing to be done")

    monkeypatch.setattr("mpdt.train.run.pipeline.results_header", fail)
    assert call("adapt", folder, "--data", tiny_file, "-q", "--adapt.steps", 2) == 1
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("damage", ["half", "none", "a folder"])
def test_a_log_that_is_not_the_run_s_is_told_before_anything_is_written(
    again, tiny_file, capsys, damage
):
    folder, _ = again
    log = folder / "metrics.jsonl"
    if damage == "half":
        os.truncate(log, log.stat().st_size // 2)
    else:
        log.unlink()
    if damage == "a folder":
        log.mkdir()
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert call("adapt", folder, "--data", tiny_file, "-q", "--adapt.steps", 2) == 1
    error = capsys.readouterr().err
    assert str(log) in error and "hint:" in error and "Traceback" not in error
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_the_published_protocol_has_no_path_to_rewards(again, tiny_file, other_rewards_file):
    """X of another reward gives the same scores to every row that does not say it reads them."""
    folder, _ = again
    starts = ["cross", "cross_mean", "cross_one", "cross_random", "infer", "infer_aligned"]
    words = ["--adapt.starts", *starts, "--adapt.infer.steps", 5, "-q"]
    found = []
    for file in (tiny_file, other_rewards_file):
        assert call("adapt", folder, "--data", file, *words) == 0
        rows = [s for s in results_of(folder)["scores"] if "reads" in s]
        found.append({(s["method"], s["task"]): (s["reads"], s["mean"]) for s in rows})
    plain, other = found
    blind = {row for row, (reads, _) in plain.items() if reads in ("X", "nothing")}
    seeing = {row for row, (reads, _) in plain.items() if reads == "X+rewards"}
    assert {row for row, score in plain.items() if other[row] == score} == blind
    assert len(blind) == 5 * 3 and len(seeing) == 2 * 3, "rows of two tasks and their mean"


def test_another_family_or_other_episodes_are_named(again, tiny_file, monkeypatch, capsys):
    from dataclasses import replace

    def load_with(**changes):
        def load(*args):
            material = load_material(*args)
            return replace(material, dataset=replace(material.dataset, **changes))

        monkeypatch.setattr("mpdt.train.run.prepare.load_material", load)

    folder, _ = again
    load_with(family="cheetah_vel")
    assert call("adapt", folder, "--data", tiny_file) == 1
    error = capsys.readouterr().err
    assert "was trained on another family; expected cheetah_dir, found cheetah_vel" in error
    load_with(content_hash="0" * 64)
    assert call("adapt", folder, "--data", tiny_file) == 1
    error = capsys.readouterr().err
    assert "was trained on other episodes; expected " in error and "found 000000000000" in error
    assert "take the file it was trained on" in error


def test_what_training_cost_is_known_to_later_judgements(again):
    folder, arguments = again
    assert results_of(folder)["seconds"]["training"] > 0
    (folder / "spent.json").write_text('{"training_s": 123.4}')
    assert call(*arguments, "--adapt.steps", 3, "-q") == 0
    seconds = results_of(folder)["seconds"]
    assert seconds["training"] == 123.4
    assert set(seconds) == {"training", "adaptation", "judging", "all"}
    assert min(seconds.values()) > 0, "each part took its time"
    assert seconds["all"] == pytest.approx(sum(seconds.values()) / 2, abs=0.02)
    assert results_of(folder)["machine"]["cores"] == len(os.sched_getaffinity(0))
    for odd in (f'{{"training_s": {10**400}}}', '{"training_s": -1}', "[]", '{"training_s": "x"}'):
        (folder / "spent.json").write_text(odd)
        assert Spent(RunFolder(folder)).training_s == 123.4
    # A run from before this was kept: its first results say it, also once they are set aside.
    (folder / "spent.json").unlink()
    assert call(*arguments, "--adapt.steps", 2, "-q") == 0
    assert results_of(folder)["seconds"]["training"] == 123.4


def test_a_stopped_run_adds_up_what_it_cost(tiny_file, tmp_path):
    arguments = ["--data", tiny_file, *QUICK, "--runs-dir", tmp_path, "--name", "r", "-q"]
    assert call(*arguments, "--time-limit-s", "1e-9") == 0
    (tmp_path / "r/spent.json").write_text('{"training_s": 1000.0}')
    assert call(*arguments) == 0
    assert results_of(tmp_path / "r")["seconds"]["training"] > 1000


def test_every_checkpoint_and_all_weights_find_their_lines_on_the_disk(
    tiny_file, tmp_path, monkeypatch
):
    """A power loss after a checkpoint must not leave a log shorter than the checkpoint says."""
    from mpdt.train.fit import checkpoint
    from mpdt.train.fit.log import MetricsLog
    from mpdt.train.run import trainer

    events = []
    sync = MetricsLog.sync

    def note(self):
        events.append(f"log {self.size_bytes}")
        sync(self)

    monkeypatch.setattr(MetricsLog, "sync", note)
    for module in (checkpoint, trainer):
        save = module.save_weights

        def noted(path, tensors, header, save=save):
            events.append(f"weights {header.settings['metrics_bytes']}")
            save(path, tensors, header)

        monkeypatch.setattr(module, "save_weights", noted)
    assert call("--data", tiny_file, *QUICK, "--runs-dir", tmp_path, "--name", "r", "-q") == 0
    saved = [row for row, event in enumerate(events) if event.startswith("weights")]
    assert len(saved) >= 4
    assert all(events[row - 1] == events[row].replace("weights", "log") for row in saved)
