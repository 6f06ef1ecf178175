"""The command as a user types it: a whole run, stop and resume, refusals, exit codes."""

import json
import os
import shutil
import signal

import h5py
import numpy as np
import pytest

from mpdt.errors import UsageError
from mpdt.model.weights import load_weights
from mpdt.train.acting import until_stopped
from mpdt.train.cli import Run, main, parse_settings
from mpdt.train.run.presets import get_preset
from mpdt.train.run.progress import Progress
from mpdt.train.run.show import settings_text
from mpdt.train.run.stop import Stopped

QUICK = ["--preset", "smoke", "--threads", "1", "--statistics.batches", "1",
         "--evaluation.horizon", "3", "--multitask.checkpoint-every", "6"]  # fmt: skip


def call(*arguments):
    """Exit code of one call."""
    with pytest.raises(SystemExit) as stopped:
        main([str(argument) for argument in arguments])
    return stopped.value.code


@pytest.fixture(scope="module")
def finished(tiny_file, tmp_path_factory):
    runs = tmp_path_factory.mktemp("runs")
    assert call("--data", tiny_file, *QUICK, "--runs-dir", runs, "--name", "whole", "-q") == 0
    return runs / "whole"


def test_a_run_leaves_its_files(finished):
    assert {path.name for path in finished.iterdir()} == {
        "config.json", "metrics.jsonl", "teacher.safetensors", "weights.safetensors",
        "results.json", "report.md", "spent.json", "policy",
    }  # fmt: skip
    header, tensors = load_weights(finished / "weights.safetensors", kind="mpdt")
    assert {"run", "backbone", "data"} == set(header.hashes)
    assert header.settings["updates"] == {"teacher": 20, "student": 20}
    assert tensors["prompts.cross"].shape == (4, 64)
    assert not any("backbone" in name for name in tensors), "trainables only"


def test_the_table_has_every_row_once(finished):
    results = json.loads((finished / "results.json").read_text())
    rows = [(s["block"], s["method"]) for s in results["scores"] if s["task"] == "mean"]
    trivial = ["zero action", "random", "best constant"]
    assert rows == [
        *[("train", method) for method in (*trivial, "expert", "MPDT")],
        *[("test", method) for method in (*trivial, "expert", "MPDT from cross, adapted",
                                          "MPDT P_c o mean P_k, not adapted")],
    ]  # fmt: skip
    assert results["updates"] == {"teacher": 20, "student": 20}
    # P_c 4x64, two tasks of 4 + 64, time table 1000x64, head 64x64+64 and 64x6+6
    assert results["num_trainables"] == 256 + 2 * 68 + 64000 + 4160 + 390


def test_references_of_another_horizon_are_not_shown(finished):
    scores = json.loads((finished / "results.json").read_text())["scores"]
    assert all(s["mean"] is None for s in scores if s["method"] == "expert")


def test_links_in_a_run_are_neither_read_nor_written_through(tiny_file, finished, tmp_path, capsys):
    """A folder from elsewhere may have some; --restart removes them."""
    theirs = tmp_path / "diary.txt"
    theirs.write_text("private")
    folder = shutil.copytree(finished, tmp_path / "r")
    again = ["--data", tiny_file, *QUICK, "--runs-dir", tmp_path, "--name", "r", "-q"]
    for name in ("report.md", "results.json", "metrics.jsonl", "judged"):
        (folder / name).unlink(missing_ok=True)
        (folder / name).symlink_to(theirs)
        for words in (again, ("report", folder), ("adapt", folder, "--data", tiny_file)):
            assert call(*words) == 1
            assert f"{name}: a link in the folder of a run" in capsys.readouterr().err
        (folder / name).unlink()
        shutil.copytree(finished, folder, dirs_exist_ok=True)
    assert theirs.read_text() == "private"


@pytest.mark.parametrize("name", ["metrics.jsonl", "results.json", "policy", "judged"])
def test_a_folder_for_a_file_and_a_file_for_a_folder(tiny_file, finished, tmp_path, capsys, name):
    """Told before a judgement begins, not when its results are to be written."""
    folder = shutil.copytree(finished, tmp_path / "r")
    place = folder / name
    if place.exists():
        place.rename(tmp_path / "away")
    if place.suffix:
        place.mkdir()
    else:
        place.touch()
    before = sorted(folder.rglob("*"))
    for words in (("report", folder), ("adapt", folder, "--data", tiny_file)):
        assert call(*words) == 1
        error = capsys.readouterr().err
        assert f"{name}: not what a run keeps" in error and f"hint:  move {place}" in error
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("name", ["notes.txt", "nowhere"])
def test_a_report_of_no_folder(tmp_path, capsys, name):
    (tmp_path / "notes.txt").touch()
    assert call("report", tmp_path / name) == 2
    assert "no folder of a run or a study" in capsys.readouterr().err


def test_a_run_is_pushed_as_its_policy(finished, tmp_path):
    assert call("push", finished, tmp_path / "sent", "-q") == 0
    assert {path.name for path in (tmp_path / "sent").iterdir()} >= {"config.json", "README.md"}


def test_stop_and_resume_gives_the_same_bytes(tiny_file, finished, tmp_path, monkeypatch, capsys):
    """SIGTERM in the middle of the student, then the same command again."""
    update = Progress.update

    def interrupt(self, phase, done, total, text=""):
        if phase == "student" and done == 9:
            os.kill(os.getpid(), signal.SIGTERM)
        update(self, phase, done, total, text)

    arguments = ["--data", tiny_file, *QUICK, "--runs-dir", tmp_path, "--name", "broken"]
    with monkeypatch.context() as patch:
        patch.setattr(Progress, "update", interrupt)
        assert call(*arguments) == 143
    assert "stopped by SIGTERM; saved. Continue with the same command" in capsys.readouterr().err
    assert not (tmp_path / "broken/results.json").exists()
    assert call(*arguments) == 0
    assert "resuming student after 9 of 20 updates" in capsys.readouterr().err
    for name in ("metrics.jsonl", "weights.safetensors", "teacher.safetensors"):
        assert (tmp_path / "broken" / name).read_bytes() == (finished / name).read_bytes(), name
    whole, broken = (json.loads((path / "results.json").read_text())
                     for path in (finished, tmp_path / "broken"))  # fmt: skip
    assert whole["scores"] == broken["scores"]


def test_a_finished_run_is_looked_up_not_repeated(tiny_file, finished, capsys):
    before = (finished / "weights.safetensors").stat().st_mtime_ns
    arguments = ["--data", tiny_file, *QUICK, "--runs-dir", finished.parent, "--name", "whole"]
    assert call(*arguments, "--json") == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == json.loads((finished / "results.json").read_text())
    assert "this run is done" in err and "content " in err
    assert (finished / "weights.safetensors").stat().st_mtime_ns == before


def test_other_settings_in_the_same_folder_are_refused(tiny_file, finished, capsys):
    arguments = ["--data", tiny_file, *QUICK, "--runs-dir", finished.parent, "--name", "whole"]
    assert call(*arguments, "--seed", 1) == 1
    error = capsys.readouterr().err
    assert "another run lives in this folder; found seed 0 -> 1" in error
    assert "--name whole-2" in error and "--restart" in error


def test_restart_never_eats_a_folder_without_a_run(tiny_file, tmp_path, capsys):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/thesis.txt").write_text("years")
    arguments = ["--data", tiny_file, *QUICK, "--runs-dir", tmp_path, "--name", "mine"]
    assert call(*arguments, "--restart") == 1 and call(*arguments) == 1
    assert (tmp_path / "mine/thesis.txt").read_text() == "years"


def test_report_prints_the_tables_again(finished, capsys):
    assert call("report", finished) == 0
    out = capsys.readouterr().out
    assert "Training tasks" in out and "zero action" in out and "not measured" in out
    assert call("report", finished.parent) == 2
    assert "no results here" in capsys.readouterr().err


def test_without_adaptation_and_teacher(medium_file, tmp_path, capsys):
    """A cut-out of one quality without a TTA set: trains on what is there."""
    quick = [*QUICK, "--runs-dir", tmp_path, "--name", "m"]
    assert call("--data", medium_file, *quick) == 1
    assert "no set for test-time adaptation" in capsys.readouterr().err
    assert not (tmp_path / "m").exists(), "nothing half-written"
    plain = [*quick, "--adapt.starts", "none", "--teacher.distillation", "none"]
    assert call("--data", medium_file, *plain, "--evaluation.no-constants", "--steps", 2) == 0
    results = json.loads((tmp_path / "m/results.json").read_text())
    assert results["updates"] == {"teacher": 0, "student": 2}
    assert results["data"]["quality"] == "medium"
    assert not (tmp_path / "m/teacher.safetensors").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["--data", "nowhere.h5"], 2, "nowhere.h5: no such file"),
        (["--data", "FILE", "--preset", "smoek"], 2, "(did you mean 'smoke'?)"),
        (["--data", "FILE", "--quality", "exprt"], 2, "(did you mean 'expert'?)"),
        (
            ["--data", "FILE", "--backbone.name", "random:tinny", *QUICK],
            2,
            "(did you mean 'tiny'?)",
        ),
        (["--data", "FILE:fw"], 2, "(did you mean 'few'?)"),
        (["--data", "FILE", "--name", "../x"], 2, "cannot name a run"),
        (["--data", "FILE", "--adapt.set", "defalt"], 2, "(did you mean 'default'?)"),
        (["--data", "FILE", "--sampler.window", "0"], 2, "sampler.window"),
        (["--data", "FILE", "--time-limit-s", "-1"], 2, "--time-limit-s"),
        (["--data", "FILE", *QUICK, "--backbone.depth", "9"], 2, "1 to 2 blocks"),
        (["--data", "FILE", *QUICK, "--adapt.layers", "5"], 2, "adapt.layers"),
        (["--data", "FILE", *QUICK, "--evaluation.horizon", "1001"], 2, "inputs.time_table"),
        (["--data", "FILE", *QUICK, "--inputs.time-table", "8"], 2, "at least 9"),
        (["--data", "FILE", *QUICK, "--prompts.length", "252"], 2, "at most 256 positions"),
        (["rnu"], 2, "(did you mean 'run'?)"),
    ],
)
def test_refusals_are_one_clear_error(tiny_file, tmp_path, capsys, arguments, code, text):
    arguments = [a.replace("FILE", str(tiny_file)) for a in arguments]
    if arguments[0] == "--data":
        arguments += ["--runs-dir", str(tmp_path)]
    assert call(*arguments) == code
    error = capsys.readouterr().err
    assert text in error and "Traceback" not in error
    assert not list(tmp_path.iterdir()), "a refused run leaves nothing behind"


def test_settings_lists_every_option_with_its_value(capsys):
    assert call("settings", "--preset", "paper") == 0
    lines = capsys.readouterr().out.splitlines()
    assert "--prompts.length 30" in lines and "--adapt.starts cross" in lines


@pytest.mark.parametrize("name", ["smoke", "paper"])
def test_the_listed_settings_can_be_typed_back(name):
    """Whatever the preset, typing its whole list over `base` gives it."""
    text = settings_text(get_preset(name), as_json=False)
    assert parse_settings(Run(data="x"), text.split()) == get_preset(name)


def test_overrides_and_the_share_of_the_teacher():
    """base: teacher 1000 of 3000 updates, so 300 give it 100."""
    config = parse_settings(Run(data="x", steps=300), ["--inputs.return-to-go", "family"])
    assert (config.teacher.steps, config.multitask.steps) == (100, 300)
    assert config.inputs.return_to_go == "family"
    config = parse_settings(Run(data="x", method="MT-BC", adapt="infer"), ["--seed", "3"])
    assert (config.method, config.prompts.kind, config.adapt.starts) == (
        "MT-BC",
        "none",
        ("infer",),
    )
    assert config.seed == 3
    with pytest.raises(UsageError, match="unknown preset"):
        parse_settings(Run(data="x", preset="y"), [])


@pytest.mark.parametrize("name", ["steps/rewards", "tta/default/steps/actions"])
def test_damage_ends_a_training_before_anything_is_kept(tiny_file, tmp_path, name, capsys):
    """The first number of the first episode, and of the set that adaptation reads."""
    damaged = tmp_path / "damaged.h5"
    data = bytearray(tiny_file.read_bytes())
    with h5py.File(tiny_file) as file:
        row = 0 if name.startswith("tta") else int(file["episodes/start"][expert_row(file)])
        data[file[name].id.get_offset() + 4 * row] ^= 4
    damaged.write_bytes(data)
    arguments = ["--data", damaged, *QUICK, "--runs-dir", tmp_path, "--name", "run", "-q"]
    for _ in range(2):  # also where checkpoints are there already
        assert call(*arguments) == 1
        error = capsys.readouterr().err
        assert "does not have the bytes of its digest" in error
        assert ("of the TTA set" in error) == name.startswith("tta")
        (kept,) = (tmp_path / "run").glob("*.safetensors")
        assert load_weights(kept)[0].settings["step"] == 0
        assert not (tmp_path / "run/results.json").exists()


def expert_row(file):
    return int(np.flatnonzero(file["episodes/quality"][:] == 2)[0])


def test_watch_shows_the_tables_of_a_finished_run(finished, capsys):
    assert call("watch", finished) == 0
    assert "MPDT from cross, adapted" in capsys.readouterr().out
    assert call("watch", finished, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["state"] == "done" and told["phases"]["student"]["done"] == 20
    assert ("test", "zero action") in [(row["tasks"], row["method"]) for row in told["returns"]]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_short_command_that_is_ended_cleans_up(finished, tmp_path, monkeypatch, capsys, number,
                                                 code):  # fmt: skip
    def ended(path):
        os.kill(os.getpid(), number)

    monkeypatch.setattr("mpdt.disk.replace.sync", ended)
    with pytest.raises(SystemExit) as end:
        main(["report", str(finished), "--html", str(tmp_path / "x.html")])
    assert end.value.code == code and not list(tmp_path.iterdir())
    error = capsys.readouterr().err
    assert (
        error.startswith("interrupted; go on with: mpdt-train report ") and error.count("\n") == 1
    )


@pytest.mark.parametrize(
    ("at_once", "judges", "told"),
    [(False, False, "saved. Continue"), (True, False, "what was saved before stays. Continue"),
     (False, True, "not judged. Begin again"), (True, True, "not judged. Begin again")],
)  # fmt: skip
def test_nothing_is_called_saved_that_is_not(capsys, at_once, judges, told):
    def stopped(stop):
        raise Stopped(signal.SIGINT, at_once)

    assert until_stopped(stopped, judges) == 130
    assert f"stopped by SIGINT; {told} with the same command:\n" in capsys.readouterr().err


def test_no_password_is_printed_when_a_command_is_stopped(monkeypatch, capsys):
    def stopped(stop):
        raise Stopped(signal.SIGINT)

    words = ["rollout", "http://me:secret@host/policy", "-o", "r.h5", "--restart"]
    monkeypatch.setattr("sys.argv", ["mpdt-train", *words])
    assert until_stopped(stopped) == 130
    error = capsys.readouterr().err
    assert "mpdt-train rollout" in error and "host/policy" in error and "-o r.h5" in error
    assert "secret" not in error and "--restart" not in error


def test_a_page_is_there_whenever_the_reader_of_the_tables_leaves(finished, tmp_path, monkeypatch):
    def leave(*_):
        raise BrokenPipeError

    monkeypatch.setattr("mpdt.train.report.show.print_results", leave)
    with pytest.raises(BrokenPipeError):
        main(["report", str(finished), "--html", str(tmp_path / "x.html")])
    assert (tmp_path / "x.html").exists()
