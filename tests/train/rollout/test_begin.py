"""Training on from a bundle: the first policy is the old one; identity and card say so."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from makers import make_episode, make_header, source_of

import mpdt
from mpdt.data.slices.standard import standard_additions
from mpdt.data.store.tables import TaskRow
from mpdt.data.store.writer import write_file
from mpdt.seeding import generator_of
from mpdt.train.bundle.read import read_bundle, read_config
from mpdt.train.run.identity import plain_settings
from mpdt.train.run.presets import smoke

from .conftest import QUICK, run

AFTER = [*QUICK[:4], "--statistics.batches", "1", "--adapt.starts", "none", "--few-shot.qualities",
         "--evaluation.horizon", "3", "--evaluation.episodes", "2", "--evaluation.no-constants",
         "--evaluation.blocks", "train"]  # fmt: skip
NOTHING = ["--multitask.steps", "0", "--teacher.steps", "0", "--teacher.distillation", "none"]


def words(data, folder, name, *more):
    return ["--data", data, *AFTER, "--runs-dir", folder, "--name", name, *more]


@pytest.fixture(scope="module")
def data(trained):
    return trained.parent.parent / "tiny.h5"


def test_without_an_update_it_is_the_policy_it_began_from(trained, data, tmp_path, capsys):
    assert run(*words(data, tmp_path, "n", *NOTHING, "--from", trained)) == 0
    told = capsys.readouterr().err
    assert "begins from r (cheetah_dir" in told and "P_c, P_k of 2 of 2 tasks" in told
    old, new = read_bundle(trained / "policy"), read_bundle(tmp_path / "n" / "policy")
    assert old.prompts["own"].equal(new.prompts["own"])
    theirs, own = old.policy.own_state(), new.policy.own_state()
    assert all(theirs[name].equal(own[name]) for name in theirs)
    first, second = (mpdt.load_policy(one) for one in (trained / "policy", tmp_path / "n"))
    seen = generator_of(1).standard_normal((4, 20)).astype(np.float32)
    assert first.act_batch(seen).tobytes() == second.act_batch(seen).tobytes()


def test_it_is_recorded_and_goes_on_as_one_run(trained, data, tmp_path, capsys):
    seal = json.loads((trained / "policy" / "config.json").read_text())["seal"]
    command = words(data, tmp_path, "n", "-q", "--from", trained / "policy")
    assert run(*command) == 0
    stored = json.loads((tmp_path / "n" / "config.json").read_text())
    assert stored["training"]["began_from"] == seal
    assert read_config(tmp_path / "n" / "policy").training.settings["began_from"] == seal
    assert seal in (tmp_path / "n" / "policy" / "README.md").read_text()
    before = (tmp_path / "n" / "weights.safetensors").read_bytes()
    assert run(*command) == 0, "done: looked up"
    assert run("evaluate", tmp_path / "n", "--data", data, "-q", "--evaluation.seed", 4) == 0
    assert (tmp_path / "n" / "weights.safetensors").read_bytes() == before
    assert run(*command[:-2]) == 1, "without --from it is another run"
    assert "another run lives in this folder" in capsys.readouterr().err


def test_runs_without_it_are_who_they_were():
    assert "began_from" not in plain_settings(smoke())


def test_weights_that_are_gone_need_the_bundle_again(trained, data, tmp_path, capsys):
    command = words(data, tmp_path, "n", "-q", "--from", trained)
    assert run(*command) == 0
    (tmp_path / "n" / "weights.safetensors").unlink()
    (tmp_path / "n" / "results.json").unlink()
    seal = json.loads((trained / "policy" / "config.json").read_text())["seal"]
    same = [*command[:-2], "--inputs.previous-action",
            "--inputs.return-to-go", "task", "--began-from", seal]  # fmt: skip
    assert run(*same) == 2
    assert "this run begins from a bundle" in capsys.readouterr().err
    assert run(*command) == 0


def test_another_family_takes_what_fits(trained, tmp_path, capsys):
    draws = generator_of(0)
    episodes = [
        make_episode(
            4, sizes=(27, 8), task=task, quality=2,
            observations=draws.standard_normal((5, 27)).astype(np.float32),
            actions=draws.uniform(-1, 1, (4, 8)).astype(np.float32),
        )
        for task in (0, 1)
    ]  # fmt: skip
    rows = [TaskRow("dir-00", 0, "train", {}), TaskRow("dir-01", 1, "train", {})]
    other = tmp_path / "ant.h5"
    header = make_header(episodes, rows, family="ant_dir")
    write_file(other, header, source_of(episodes), finish=standard_additions)
    assert run(*words(other, tmp_path, "n", *NOTHING, "--from", trained)) == 0
    told = capsys.readouterr().err
    assert "P_c" in told.split("begins anew")[0]
    anew = told.split("begins anew: ")[1].splitlines()[0]
    assert "inputs" in anew and "head" in anew and "prompts.task_v" not in anew
    old, new = read_bundle(trained / "policy"), read_bundle(tmp_path / "n" / "policy")
    assert old.trained["cross"].equal(new.trained["cross"])
    assert not torch.equal(old.trained["task_v"], new.trained["task_v"])


def test_what_does_not_fit_is_said_before_anything_is_written(trained, data, tmp_path, capsys):
    for setting in (["--prompts.length", "7"], ["--head.hidden", "5"]):
        assert run(*words(data, tmp_path, "n", "--from", trained, *setting)) == 2
        assert "does not fit this run's settings" in capsys.readouterr().err
    assert run(*words(data, tmp_path, "n", "--from", trained, "--backbone.depth", "1")) == 2
    assert "another language model" in capsys.readouterr().err
    assert run(*words(data, tmp_path, "n", "--from", tmp_path / "nobody")) == 2
    assert not (tmp_path / "n").exists()
