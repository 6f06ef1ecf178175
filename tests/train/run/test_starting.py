"""Before the first update: no such folder, a full disk, a kill, Ctrl-C: clear, and nothing left."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from safetensors.torch import load_file, save_file

from mpdt.errors import FormatError, StorageError, TrainingError
from mpdt.model.backbone import load_backbone
from mpdt.train.fit.data import load_material
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.folder import FORMAT, claimed, inspect, locate, stored_settings
from mpdt.train.run.identity import Identity
from mpdt.train.run.prepare import prepare

from .command import QUICK, call, names_in


@pytest.mark.parametrize("place", ["file", "inside", "link"])
def test_a_folder_that_cannot_be(tiny_file, tmp_path, capsys, place):
    (tmp_path / "r").write_text("mine") if place == "file" else None
    (tmp_path / "runs").write_text("mine") if place == "inside" else None
    (tmp_path / "r").symlink_to(tmp_path / "nowhere" / "x") if place == "link" else None
    before = names_in(tmp_path)
    runs = tmp_path / "runs" if place == "inside" else tmp_path
    arguments = ["--data", tiny_file, *QUICK, "--runs-dir", runs, "--name", "r"]
    for extra in ([], ["--restart"]):
        assert call(*arguments, *extra, "-q") == 1
        error = capsys.readouterr().err
        assert error.startswith("error: ") and "a file is in the way" in error
        assert names_in(tmp_path) == before


def test_no_permission_is_said_before_the_backbone_is_loaded(
    tiny_file, tmp_path, capsys, monkeypatch
):
    from mpdt.train.run import folder

    monkeypatch.setattr(folder.os, "access", lambda path, mode: path != tmp_path)
    assert call("--data", tiny_file, *QUICK, "--runs-dir", tmp_path, "--name", "r") == 1
    error = capsys.readouterr().err
    assert "no permission to write there" in error and "backbone" not in error


def test_a_folder_that_cannot_be_read_is_one_clear_error(tmp_path, monkeypatch):
    def refuse(path):
        raise PermissionError(13, "Permission denied")

    (tmp_path / "r").mkdir()
    monkeypatch.setattr(Path, "iterdir", refuse)
    with pytest.raises(StorageError, match="Permission denied"):
        inspect(locate(tmp_path, "r"), Identity({}, {}), restart=False)


def test_a_full_disk_leaves_no_folder(tiny_file, tmp_path, monkeypatch, capsys):
    from mpdt.train.run import folder

    def full(path, content):
        raise StorageError("the disk is full", where=str(path))

    monkeypatch.setattr(folder, "write_bytes", full)
    assert call("--data", tiny_file, *QUICK, "--runs-dir", tmp_path, "--name", "r", "-q") == 1
    assert "the disk is full" in capsys.readouterr().err
    assert names_in(tmp_path) == []


@pytest.mark.parametrize(
    "leftover", ["run.pid", "config.json.tmp", ".config.json.0123456789abcdef.tmp"]
)
def test_a_kill_in_the_first_moment_does_not_block_the_name(
    tiny_file, tmp_path, leftover, monkeypatch
):
    identity = prepare(TrainConfig(), str(tiny_file)).identity
    own = locate(tmp_path, "r")
    own.path.mkdir()
    (own.path / leftover).write_text("1")
    with claimed(own, identity, restart=False):
        assert own.config.exists()


@pytest.mark.parametrize(
    ("damage", "told"),
    [({"training": None}, "no object 'training' with its 'data'; found null"),
     ({"training": []}, "no object 'training' with its 'data'; found []"),
     ({"training": {"data": [1]}}, "no object 'training' with its 'data'"),
     ({"judging": {}}, "no object 'judging' with its 'data'; found {}"),
     ({"training": {"data": {}, "seed": "one"}}, "Expected `int`, got `str` - at `$.seed`")],
)  # fmt: skip
def test_a_damaged_configuration_is_one_error(tiny_file, tmp_path, damage, told):
    """Of a run that goes on, and of one that is adapted."""
    identity = prepare(TrainConfig(), str(tiny_file)).identity
    own = locate(tmp_path, "r")
    own.path.mkdir()
    whole = {"format": FORMAT, "training": {"data": {}}, "judging": {"data": {}}}
    own.config.write_text(json.dumps(whole | damage))
    with pytest.raises(FormatError) as caught:
        stored_settings(own.path)
    assert told in str(caught.value) and caught.value.where == str(own.config)
    with pytest.raises((FormatError, TrainingError)):
        inspect(own, identity, restart=False)


WAIT = """
import builtins, sys, time
real = builtins.__import__
def slow(name, *rest, **named):
    if name == "torch" or name.startswith("mpdt.train.run.pipeline"):
        print("importing", flush=True)
        try:
            time.sleep(60)
        except BaseException as error:
            raise ImportError("as libraries do") from error
    return real(name, *rest, **named)
builtins.__import__ = slow
from mpdt.train.cli import main
main(sys.argv[1:])
"""


def test_ctrl_c_while_libraries_are_imported(tiny_file):
    process = subprocess.Popen(
        [sys.executable, "-c", WAIT, "--data", str(tiny_file)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout.readline() == "importing\n"
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=30)
    assert process.returncode == 130 and error == "\ninterrupted\n"


def test_one_training_task_is_too_few_for_a_shared_prompt(tiny_file, tmp_path, monkeypatch, capsys):
    from dataclasses import replace

    monkeypatch.setattr(
        "mpdt.train.run.prepare.load_material",
        lambda *a: replace(load_material(*a), train_rows=(0,)),
    )
    arguments = ["--data", tiny_file, *QUICK, "--runs-dir", tmp_path, "--name", "one"]
    assert call(*arguments) == 1
    assert "expected at least 2 training tasks" in capsys.readouterr().err
    assert not (tmp_path / "one").exists()


def test_a_language_model_that_is_not_whole_is_refused_before_training(
    tiny_file, tmp_path, monkeypatch, capsys
):
    """Saved from a compiled model: every name has a prefix, and the library would draw others."""
    monkeypatch.chdir(tmp_path)
    load_backbone("random:tiny-llama").model.save_pretrained("compiled")
    weights = tmp_path / "compiled" / "model.safetensors"
    renamed = {f"_orig_mod.{name}": value for name, value in load_file(weights).items()}
    save_file(renamed, weights, metadata={"format": "pt"})
    assert call("--data", tiny_file, "--name", "r", *QUICK, "--backbone.name", "compiled") == 2
    error = capsys.readouterr().err
    assert error.count("does not fit this language model") == 1 and "Traceback" not in error
    assert names_in(tmp_path) == ["compiled"]
