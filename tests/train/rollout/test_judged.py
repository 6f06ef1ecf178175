"""A run's episodes kept beside its table, and its bundle judged as somebody else's policy."""

from __future__ import annotations

import importlib
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from makers import make_episode, make_header, source_of

import mpdt
from mpdt.data.collect.standing import standing_spec
from mpdt.data.slices.standard import standard_additions
from mpdt.data.spec.tasks import get_family
from mpdt.data.store.reader import open_dataset
from mpdt.data.store.tables import TaskRow
from mpdt.data.store.writer import write_file
from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import CHECKS, verify
from mpdt.errors import DataError, UsageError
from mpdt.seeding import generator_of
from mpdt.train.adapt.trials.protocol import spoken
from mpdt.train.bundle.format import FamilyFacts
from mpdt.train.bundle.read import read_bundle, read_config
from mpdt.train.bundle.select import policy_of_bundle
from mpdt.train.run.bench import Bench
from mpdt.train.run.judge_outside import _material, check_fits

from .conftest import run


def told(results, block, method):
    return {
        s["task"]: s["mean"]
        for s in results["scores"]
        if (s["block"], s["method"]) == (block, method)
    }


def returns(path):
    kept = open_dataset(path)
    return {
        name: kept.episodes.returns[kept.episodes.task == row].mean()
        for row, name in enumerate(kept.tasks.names)
    }


def test_a_run_keeps_the_episodes_of_each_row(trained, tmp_path, capsys):
    data = trained.parent.parent / "tiny.h5"
    before = json.loads((trained / "results.json").read_text())["scores"]
    words = ["evaluate", trained, "--data", data, "--keep", tmp_path / "e.h5", "-q", "--json"]
    assert run(*words) == 0
    results = json.loads(capsys.readouterr().out)
    assert results["scores"] == before, "keeping changes no number"
    found = {path.stem: returns(path) for path in sorted(tmp_path.iterdir())}
    assert list(found) == ["e-cross", "e-none", "e-own"]
    methods = {
        "e-own": ("train", "MPDT"),
        "e-cross": ("test", "MPDT from cross, adapted"),
        "e-none": ("test", "MPDT P_c o mean P_k, not adapted"),
    }
    for stem, row in methods.items():
        table = told(results, *row)
        assert found[stem] == {task: table[task] for task in ("forward", "backward")}
        report = verify(tmp_path / f"{stem}.h5", replay="all")
        assert report.count(Outcome.PASS) == len(CHECKS) - 1 and report.count(Outcome.NONE) == 1
    own = open_dataset(tmp_path / "e-own.h5")
    with pytest.raises(DataError, match="nothing more is made of a policy's episodes"):
        standing_spec(own)
    assert own.policies.hashes[0].tobytes() == mpdt.load_policy(trained / "policy").fingerprint


def test_a_bundle_is_judged_to_the_same_numbers(trained, tmp_path, capsys):
    data = trained.parent.parent / "tiny.h5"
    ours = json.loads((trained / "results.json").read_text())
    words = ["evaluate", "--policy", trained, "--data", data, "--keep", tmp_path / "b.h5", "--json",
             "-q", "--evaluation.horizon", 3, "--evaluation.episodes", 2]  # fmt: skip
    assert run(*words) == 0
    theirs = json.loads(capsys.readouterr().out)
    assert told(theirs, "train", "r own") == told(ours, "train", "MPDT")
    assert told(theirs, "test", "r cross") == told(ours, "test", "MPDT from cross, adapted")
    for block in ("train", "test"):
        assert told(theirs, block, "random") == told(ours, block, "random")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["b-cross.h5", "b-none.h5", "b-own.h5"]
    assert run(*words, "--reads", "X") == 2
    assert "a bundle says itself what was read" in capsys.readouterr().err


def test_what_is_left_out_of_a_bundle_is_said_to_be(trained):
    bundle = read_bundle(trained / "policy")
    config = msgspec.structs.replace(bundle.config, left_out=("trials-alone-3",))
    with pytest.raises(UsageError, match="'trials-alone-3' is left out"):
        policy_of_bundle(replace(bundle, config=config), "forward", "trials-alone-3")
    assert policy_of_bundle(bundle, np.int64(1)).task == policy_of_bundle(bundle, 1).task
    with pytest.raises(UsageError, match="unknown start '3'"):
        policy_of_bundle(bundle, 0, 3)


def test_own_episodes_are_counted_in_the_name_of_a_row():
    """The leaderboard finds its protocol by the count at the end."""
    assert spoken("trials-alone-10") == "10 own episodes" and spoken("cross") == "cross"
    assert spoken("trials-with_x-3") == "X and 3 own episodes"


def test_statistics_are_compared_before_anybody_acts(trained, tiny_file):
    config, material = read_config(trained / "policy"), _material(str(tiny_file))
    assert check_fits(config, material) == [], "the very data"
    other = msgspec.structs.replace(config.data, content_hash="0" * 64)
    config = msgspec.structs.replace(config, data=other)
    (line,) = check_fits(config, material)
    assert line.startswith("statistics of the observations: means within ")
    away = list(config.statistics.mean)
    away[3] += 11 * config.statistics.std[3]
    far = msgspec.structs.replace(config.statistics, mean=tuple(away))
    with pytest.raises(DataError, match=r"never saw: fthigh|never saw: bshin"):
        check_fits(msgspec.structs.replace(config, statistics=far), material)
    other = FamilyFacts.of(get_family("cheetah_vel"))
    lines = check_fits(msgspec.structs.replace(config, family=other), material)
    assert lines[0] == "of another family: cheetah_vel acts in cheetah_dir"
    ant = FamilyFacts.of(get_family("ant_dir"))
    with pytest.raises(UsageError, match="cannot act in cheetah_dir: other observation_size"):
        check_fits(msgspec.structs.replace(config, family=ant), material)


def test_what_is_kept_of_some_tasks_is_not_replaced_by_others(tmp_path, monkeypatch, capsys):
    """Training tasks and test tasks of one policy, judged by two commands at one name."""
    episodes = [make_episode(3, sizes=(20, 6), task=task) for task in (0, 1)]
    rows = [TaskRow("v0.075", 0, "train", {}), TaskRow("v0.150", 1, "test", {})]
    header = make_header(episodes, rows, family="cheetah_vel")
    write_file(tmp_path / "vel.h5", header, source_of(episodes), finish=standard_additions)
    (tmp_path / "resting.py").write_text(
        "import numpy as np\n\n"
        "def still(observations, rewards, starts, task):\n    return np.zeros((len(starts), 6))\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    words = ["evaluate", "--policy", "resting:still", "--data", "vel.h5", "--keep", "k.h5", "-q",
             "--evaluation.horizon", 2, "--evaluation.episodes", 1, "--evaluation.no-constants",
             "--evaluation.blocks"]  # fmt: skip
    assert run(*words, "train") == run(*words, "train") == 0
    before = (tmp_path / "k.h5").read_bytes()
    assert run(*words, "test") == 1
    assert "something else is there" in capsys.readouterr().err
    assert (tmp_path / "k.h5").read_bytes() == before


def test_another_familys_tasks_are_met_without_prompts_of_their_own(trained, tmp_path, capsys):
    """The same robot with speeds to reach: the policy has prompts for none of them."""
    draws = generator_of(0)
    episodes = [
        make_episode(
            3, sizes=(20, 6), task=task,
            observations=draws.standard_normal((4, 20)).astype(np.float32),
        )
        for task in (0, 1)
    ]  # fmt: skip
    rows = [TaskRow("v0.075", 0, "train", {}), TaskRow("v0.150", 1, "train", {})]
    header = make_header(episodes, rows, family="cheetah_vel")
    other = tmp_path / "vel.h5"
    write_file(other, header, source_of(episodes), finish=standard_additions)
    words = ["evaluate", "--policy", trained, "--data", other, "--json",
             "--evaluation.horizon", 2, "--evaluation.episodes", 2]  # fmt: skip
    assert run(*words) == 0
    printed = capsys.readouterr()
    found = told(json.loads(printed.out), "train", "r none")
    assert set(found) == {"v0.075", "v0.150", "mean"} and np.isfinite(list(found.values())).all()
    assert "of another family: cheetah_dir acts in cheetah_vel" in printed.err


def test_what_is_kept_belongs_to_one_judgement_at_a_time(trained, tmp_path, monkeypatch, capsys):
    """Another process is told at once, whichever came first; nobody's episodes are replaced."""
    hold = (
        "from pathlib import Path\nfrom mpdt.disk import holding\n"
        "with holding(Path('k.h5'), amends=True, wait_s=0): print(flush=True), input()"
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(one for one in sys.path if one))
    monkeypatch.chdir(tmp_path)
    words = ["evaluate", "--data", trained.parent.parent / "tiny.h5", "--keep", "k.h5", "-q",
             "--evaluation.horizon", 2, "--evaluation.episodes", 1, "--evaluation.blocks", "train",
             "--evaluation.no-constants", "--policy"]  # fmt: skip
    (tmp_path / "meeting.py").write_text(
        "import numpy as np\n\n"
        "def still(observations, rewards, starts, task):\n    return np.zeros((len(starts), 6))\n\n"
        "def meets(observations, rewards, starts, task):\n"
        "    if not met:\n        met.append(other())\n    return np.ones((len(starts), 6))\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    module = importlib.import_module("meeting")
    command = [sys.executable, "-c", hold]
    module.met = []
    module.other = lambda: subprocess.run(command, input="\n", capture_output=True, text=True)
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as first:
        first.stdout.readline()
        assert run(*words, "meeting:still") == 4
        first.communicate(b"\n")
    assert "k.h5: another process writes it" in capsys.readouterr().err
    assert run(*words, "meeting:meets") == 0
    (other,) = module.met
    assert other.returncode and "BusyError" in other.stderr
    assert (open_dataset(tmp_path / "k.h5").steps.actions[:] == 1).all()
    assert run(*words, "meeting:still") == 1
    assert "something else is there" in capsys.readouterr().err


def test_what_cannot_be_kept_is_told_before_anything_is_judged(
    trained, tmp_path, monkeypatch, capsys
):
    words = ["evaluate", "--policy", trained, "--data", trained.parent.parent / "tiny.h5", "-q",
             "--evaluation.blocks", "train", "--keep"]  # fmt: skip
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(Bench, "score", None)
    with monkeypatch.context() as patch:
        patch.setattr(Bench, "references", lambda *_: [])
        patch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=1000))
        assert run(*words, tmp_path / "k.h5") == 1
    assert "not enough room on the disk for the episodes" in capsys.readouterr().err
    monkeypatch.setattr(Bench, "references", None)
    (tmp_path / "k.h5").mkdir()
    assert run(*words, tmp_path / "k.h5") == 1
    assert "a folder is in the way" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["k.h5"]


@pytest.mark.parametrize("other", [["seed", 7], ["episodes", 1], ["horizon", 2]])
def test_what_is_kept_goes_for_the_same_judgement_alone(trained, tmp_path, capsys, other):
    data, kept = trained.parent.parent / "tiny.h5", tmp_path / "k-own.h5"
    words = ["evaluate", "--policy", trained, "--data", data, "--keep", tmp_path / "k.h5", "-q",
             "--evaluation.horizon", 3, "--evaluation.episodes", 2, "--evaluation.blocks", "train",
             "--evaluation.no-constants"]  # fmt: skip
    assert run(*words) == run(*words) == 0
    before = kept.read_bytes()
    name, value = other
    assert run(*words, f"--evaluation.{name}", value) == 1
    told = capsys.readouterr().err
    assert "something else is there; found episodes of another policy, of other data" in told
    assert kept.read_bytes() == before
