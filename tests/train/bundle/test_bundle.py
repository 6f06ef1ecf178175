"""A bundle holds what acting needs and acts as the run was judged; the same run, the same bytes."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest

import mpdt
from mpdt.data.sim.actors import Rows
from mpdt.data.spec.tasks import get_family
from mpdt.disk.holder import Holder
from mpdt.errors import FormatError, StorageError, UsageError
from mpdt.train.bundle.read import read_bundle, read_config
from mpdt.train.bundle.write import check_free, remove_bundle
from mpdt.train.evaluate.rollout import evaluate
from mpdt.train.report.page import run_content
from mpdt.train.run.results import read_results
from mpdt.train.run.stored import check_same_run

from .conftest import run

HORIZON, EPISODES = 3, 2


class AsActor:
    """A loaded policy in the place of a judged one; every row says which task it is."""

    def __init__(self, policy, names):
        self.policy, self.names = policy, names

    def begin(self, rows: Rows):
        self.policy.reset([self.names[task] for task in rows.tasks])

    def act(self, step, observations, rewards=None):
        return self.policy.act_batch(observations, rewards)


def judged(bundle, start, rows=("forward", "backward")):
    family = get_family("cheetah_dir")
    tasks = [family.task(name) for name in rows]
    actor = AsActor(mpdt.load_policy(bundle, start=start), rows)
    return evaluate(actor, family, tasks, {}, HORIZON, EPISODES, seed=0)


@pytest.mark.parametrize(("start", "block", "method"), [
    (None, "train", "MPDT"),
    ("cross", "test", "MPDT from cross, adapted"),
    ("few_shot_expert", "test", "MPDT few-shot expert"),
    ("none", "test", "MPDT P_c o mean P_k, not adapted"),
])  # fmt: skip
def test_returns_are_those_of_the_results(finished, bundle, start, block, method):
    scores = json.loads((finished / "results.json").read_text())["scores"]
    told = {s["task"]: s["mean"] for s in scores if (s["block"], s["method"]) == (block, method)}
    found = judged(bundle, start)
    for task, returns in zip(found.tasks, found.returns, strict=True):
        assert float(returns.mean()) == told[task]
    alone = judged(bundle, start, ("backward",))
    assert (alone.returns == found.returns[1:]).all(), "whatever else is in the batch"


def test_an_old_run_gives_the_same_bytes(finished, tmp_path):
    old = shutil.copytree(finished, tmp_path / "runs" / "r")
    shutil.rmtree(old / "policy")
    shutil.copy(finished.parent.parent / "tiny.h5", tmp_path)
    assert run("bundle", old, "-o", tmp_path / "b") == 0
    assert run("bundle", finished, "-o", tmp_path / "c") == 0
    for name in ("config.json", "model.safetensors", "README.md"):
        written = (finished / "policy" / name).read_bytes()
        assert (tmp_path / "b" / name).read_bytes() == written
        assert (tmp_path / "c" / name).read_bytes() == written
    assert run("bundle", finished, "-o", tmp_path / "c") == 1, "nothing is replaced"


def test_without_the_language_model(finished, bundle, tmp_path):
    assert run("bundle", finished, "-o", tmp_path / "small", "--without-backbone") == 0
    whole, small = ((p / "model.safetensors").stat().st_size for p in (bundle, tmp_path / "small"))
    assert small < whole
    observation = np.linspace(-1, 1, 20)
    for start in (None, "cross"):
        one, other = (mpdt.load_policy(where, "backward", start=start).act(observation)
                      for where in (bundle, tmp_path / "small"))  # fmt: skip
        assert (one == other).all()
    assert read_config(tmp_path / "small").backbone.shape is None


LOADS = """
import sys, torch
import mpdt
policy = mpdt.load_policy(sys.argv[1], task="backward")
before = torch.get_num_threads()
policy.act([0.0] * 20)
policy.act([0.0] * 20, 1.0)
assert torch.get_num_threads() == before
print(sorted(set(sys.modules) & {"transformers", "h5py", "mujoco", "gymnasium", "scipy", "fsspec",
                                 "huggingface_hub", "metaworld", "sympy", "mpdt.train.fit.loop"}))
"""


def test_loading_needs_neither_data_nor_trainer_nor_the_library(bundle, tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", LOADS, str(bundle)], cwd=tmp_path, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"
    assert list(tmp_path.iterdir()) == []


def test_a_run_s_folder_acts_from_its_bundle(finished, bundle, tmp_path):
    """Without data; a start that the run did not try needs them."""
    moved = shutil.copytree(finished, tmp_path / "far" / "away" / "r")
    policy = mpdt.load_policy(moved, "forward")
    observation = np.linspace(-1, 1, 20)
    expected = mpdt.load_policy(bundle, 0).act(observation)
    assert (policy.act(observation) == expected).all()
    with pytest.raises(FileNotFoundError, match="not here"):
        mpdt.load_policy(moved, "forward", start="cross_mean")
    with pytest.raises(UsageError, match=r"unknown start 'cros'.*did you mean 'cross'"):
        mpdt.load_policy(bundle, "forward", start="cros")
    with pytest.raises(UsageError, match="did you mean 'forward'"):
        mpdt.load_policy(bundle, "forwards")
    with pytest.raises(UsageError, match="adapts no more"):
        mpdt.load_policy(bundle, "forward", start=lambda *_: None)


def test_judging_again_replaces_the_bundle(finished, tmp_path):
    again = shutil.copytree(finished, tmp_path / "runs" / "r")
    data = finished.parent.parent / "tiny.h5"
    words = ["--few-shot.qualities", "--adapt.starts", "none", "-q"]
    assert run("adapt", again, "--data", data, *words) == 0
    config = read_config(again / "policy")
    assert [one.name for one in config.prompts] == ["own", "none"]
    assert sorted(p.name for p in (again / "policy").iterdir()) == [
        "README.md", "config.json", "model.safetensors",
    ]  # fmt: skip
    assert not [path for path in again.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize("second", [False, True])
def test_a_signal_while_an_old_bundle_goes(bundle, tmp_path, monkeypatch, second):
    target = shutil.copytree(bundle, tmp_path / "policy")
    whole = shutil.rmtree

    def stopped(path, ignore_errors=False):
        if not ignore_errors:
            if second:
                next(path.iterdir()).unlink()
            raise KeyboardInterrupt
        whole(path, ignore_errors=True)

    monkeypatch.setattr("mpdt.train.bundle.write.shutil.rmtree", stopped)
    with pytest.raises(KeyboardInterrupt):
        remove_bundle(target)
    assert not list(tmp_path.iterdir())


def test_a_damaged_bundle_of_a_run_is_made_again_of_its_weights(finished, tmp_path, capsys):
    again = shutil.copytree(finished, tmp_path / "runs" / "r")
    shutil.copy(finished.parent.parent / "tiny.h5", tmp_path)
    for name in ("model.safetensors", "config.json"):
        (again / "policy" / name).write_bytes(b"")
        assert run("bundle", again, "-o", tmp_path / "b") == 1
        assert f"hint:  move {again / 'policy'} away" in capsys.readouterr().err
    (again / "policy").rename(tmp_path / "away")
    assert run("bundle", again, "-o", tmp_path / "b") == 0
    for name in ("config.json", "model.safetensors", "README.md"):
        assert (tmp_path / "b" / name).read_bytes() == (finished / "policy" / name).read_bytes()


def test_files_of_another_run_are_not_joined(finished, tmp_path, capsys):
    again = shutil.copytree(finished, tmp_path / "r")
    config = read_config(again / "policy")
    other = {"identity": {"training": "0" * 64}}
    with pytest.raises(FormatError, match="bundle of another run"):
        check_same_run(config, other, again / "policy")
    page = run_content({**read_results(again), **other}, again)
    assert not page.maps and "trained on another run" in page.warnings[0]
    settings = json.loads((again / "config.json").read_text())
    settings["training"]["seed"] += 1
    (again / "config.json").write_text(json.dumps(settings))
    for words in (["report", again], ["watch", again, "--once"],
                  ["bundle", again, "-o", tmp_path / "b"]):  # fmt: skip
        assert run(*words) == 1
        error = capsys.readouterr().err
        assert "the results of another run" in error and "hint:  move it away" in error


def test_what_config_says(finished, bundle):
    config, read = read_config(bundle), read_bundle(bundle)
    results = json.loads((finished / "results.json").read_text())
    assert config.format == "mpdt-policy/1"
    assert config.data.content_hash == results["data"]["content_hash"]
    assert config.training.identity == results["identity"]
    assert config.backbone.fingerprint == results["backbone"]["fingerprint"]
    assert [task.role for task in config.tasks] == ["both", "both"]
    assert {one.name: one.reads for one in config.prompts} == {
        "own": None, "cross": "X", "few_shot_expert": "labelled steps", "none": "nothing",
    }  # fmt: skip
    assert len(config.statistics.mean) == 20
    assert set(read.trained) == {"cross", "task_v", "task_u"}


def test_a_lock_that_a_kill_left_beside_a_bundle_goes(bundle, tmp_path):
    target = tmp_path / "policy"
    shutil.copytree(bundle, target)
    (tmp_path / ".policy.lock").write_bytes(Holder.me().encoded())
    with pytest.raises(StorageError, match="something is there already"):
        check_free(target)
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("late", [False, True])
def test_a_signal_behind_the_last_rename_is_not_told_to_go_on(
    finished, tmp_path, monkeypatch, capsys, late
):
    """The same command would refuse what it made itself."""
    name = "sync" if late else "sync_tree"
    monkeypatch.setattr(f"mpdt.disk.replace.{name}", lambda path: signal.raise_signal(2))
    assert run("bundle", finished, "-o", tmp_path / "b") == 130
    told = capsys.readouterr().err
    assert ("nothing is left to do" in told) == late == (tmp_path / "b").exists()
    assert ("go on with: mpdt-train bundle" in told) != late
