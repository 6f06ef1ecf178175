"""A bundle as the expert of an entry: the actions of a loop of its user's, the same bytes."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

import mpdt
from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.sim import trained as bundles
from mpdt.data.sim.actors import uniform_actions
from mpdt.data.spec.entry import Behaviour, DatasetSpec, EpisodeCounts, spec_hash
from mpdt.data.spec.tasks import get_family
from mpdt.data.store.provenance import WEIGHTS
from mpdt.data.verify.verify import verify
from mpdt.errors import DataError, FormatError, MissingFileError, SpecError, UsageError
from mpdt.seeding import SeedKey, Stream


def entry(folder: Path, **behaviour: Any) -> DatasetSpec:
    return DatasetSpec(
        name="mine", version="1.0.0-smoke", family="cheetah_dir", horizon=6, seed=3, block=3,
        behaviour=Behaviour(bundle=str(folder), **({"rungs": 3} | behaviour)), reference=2,
        episodes=EpisodeCounts(random=2, expert=4, history=3), license="CC0-1.0",
    )  # fmt: skip


def lived(data: Any, id: int, noise: float = 0.0) -> None:
    """The actions of an episode, found again by a loop with the policy, coins and noise."""
    episode = data.episode(id)
    info = next(one for one in data.policy_infos() if one.hash == episode.policy)
    family, key = get_family("cheetah_dir"), SeedKey(3, *episode.seed_key)
    task = data.tasks.names[episode.task]
    policy = mpdt.load_policy(data.spec["behaviour"]["bundle"], task=task)
    coins = key.generator(Stream.POLICY).random(6) < info.mix_rate
    uniform = uniform_actions([key], 6, family.action_size, -1.0, 1.0)[0]
    added = noise * key.generator(Stream.NOISE).standard_normal((6, family.action_size))
    for step in range(episode.length):
        paid = episode.rewards[step - 1] if step else None
        action = policy.act(episode.observations[step], paid)
        if info.mix_rate or noise:
            done = uniform[step] if coins[step] else np.float64(action) + added[step]
            action = np.clip(done, -1, 1).astype(np.float32)
            policy.acted(action[None])
        assert (action == episode.actions[step]).all(), (id, step)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_its_actions_are_those_of_a_loop(trained: Path, tmp_path: Path, noise: float) -> None:
    folder = trained / "policy"
    job = make_job(entry(folder, noise=noise))
    seal = json.loads((folder / "config.json").read_text())["seal"]
    assert seal[:16] in job.notices[0] and str(folder) in job.notices[0]
    data = collect(job, tmp_path / "mine.h5", workers=0).dataset
    assert data.packages[WEIGHTS] == seal and "torch" in data.packages
    assert data.num_episodes == 2 * 9
    mixed = {one.mix_rate for one in data.policy_infos() if one.name.startswith("r")}
    assert mixed == {0.0, 0.5}
    for id in [*data.select(quality="expert"), *data.select(quality="history")]:
        if data.episodes.progress[id]:  # the first rung is uniform actions
            lived(data, int(id), noise)
    found = {one.id: one for one in verify(data.path, replay="all").findings}
    assert found["replay"].outcome.value == "PASS" and "18 episodes" in found["replay"].text


def test_a_policy_that_does_not_fit_is_one_error(trained: Path, tmp_path: Path) -> None:
    folder = trained / "policy"

    def refused(kind: type[Exception], match: str, spec: DatasetSpec) -> None:
        with pytest.raises(kind, match=match):
            make_job(spec)

    refused(MissingFileError, "no bundle here", entry(tmp_path))
    refused(UsageError, r"unknown start 'nnone'.*mine.behaviour|start 'nnone'",
            entry(folder, start="nnone"))  # fmt: skip
    other = msgspec.structs.replace(entry(folder), family="ant_dir")
    refused(SpecError, r"mine.behaviour: the policy was trained for another family; expected ant_d",
            other)  # fmt: skip
    medium = msgspec.structs.replace(entry(folder), episodes=EpisodeCounts(medium=1))
    refused(SpecError, "'forward' has no calibrated mixing rate", medium)
    damaged = tmp_path / "damaged"
    damaged.mkdir()
    for path in folder.iterdir():
        (damaged / path.name).write_bytes(path.read_bytes()[:-1])
    refused(FormatError, "not the size it was written with", entry(damaged))


def test_a_task_without_a_prompt_is_one_error(
    trained: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both tasks of the bundle have their own; here one has not, as a test task may have."""
    from mpdt.train.rollout import expert

    opened = expert.open_expert(trained, "cheetah_dir", None, "here")
    config = opened.bundle.config
    alone = tuple(msgspec.structs.replace(one, tasks=("forward",)) for one in config.prompts)
    less = msgspec.structs.replace(config, prompts=alone)
    monkeypatch.setattr(expert, "read_bundle", lambda folder: replace(opened.bundle, config=less))
    acts = SimpleNamespace(fingerprint=bytes(32))
    monkeypatch.setattr(expert, "policy_of_bundle", lambda *words: acts)
    with pytest.raises(SpecError, match="no prompt for the task backward") as caught:
        make_job(entry(trained))
    assert "one of its own, found none in any set" in str(caught.value)
    assert "behaviour.start" in caught.value.hint
    own = msgspec.structs.replace(config.prompts[0], tasks=("forward",))
    rest = msgspec.structs.replace(config.prompts[0], name="none", tasks=("backward",))
    less = msgspec.structs.replace(config, prompts=(own, rest))
    with pytest.raises(SpecError, match="found prompts in none"):
        make_job(entry(trained))


def test_another_policy_in_its_place_does_not_act(trained: Path) -> None:
    bundle = bundles.opened_bundle(entry(trained / "policy"))
    there = pickle.loads(pickle.dumps(bundle))  # as a worker gets it
    assert there._opened is None and there.prints == bundle.prints
    there.acting("forward", 2)
    there = replace(there, prints={"forward": bytes(32)}, _opened=None)
    with pytest.raises(DataError, match="another policy took its place"):
        there.acting("forward", 2)


@pytest.mark.parametrize(
    ("behaviour", "what"),
    [
        ({"bundle": "hf://me/mine"}, "'hf://me/mine' is no folder.*mpdt-train pull|is no folder"),
        ({"bundle": ""}, "'' is no folder"),
        ({"bundle": "x", "script": "y"}, "exactly one of network, script and bundle"),
        ({"script": "y", "start": "none"}, "behaviour.start: names prompts of a bundle"),
    ],
)
def test_entries_that_are_none(behaviour: Any, what: str) -> None:
    with pytest.raises(SpecError, match=what):
        msgspec.structs.replace(entry(Path("x")), behaviour=Behaviour(**behaviour))


def test_entries_of_before_keep_their_hashes() -> None:
    """The two keys are no part of what is hashed where nobody gave them."""
    plain = msgspec.structs.replace(entry(Path("x")), behaviour=Behaviour(network="cheetah_dir"))
    told = msgspec.to_builtins(plain)
    assert told["behaviour"] == {
        "network": "cheetah_dir", "script": None, "rungs": 20, "noise": 0.0
    }  # fmt: skip
    assert spec_hash(plain) == spec_hash(told)


MODULE = """
import gymnasium
import numpy as np
from gymnasium import spaces

import mpdt


class Line(gymnasium.Env):
    def __init__(self, goal):
        self.goal = goal
        self.observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float64)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.steps = float(self.np_random.uniform(-0.1, 0.1)), 0
        return np.array([self.at, 0.0]), {}

    def step(self, action):
        self.at, self.steps = self.at + float(action[0]), self.steps + 1
        away = abs(self.at - self.goal)
        return np.array([self.at, float(self.steps)]), -away, False, False, {}


def there(observations, goals):
    return np.clip(goals - observations[:, :1], -1, 1)


family = mpdt.Family(
    name="line",
    tasks=tuple(
        mpdt.Task(name, i, role, (goal,))
        for i, (name, role, goal) in enumerate(
            [("left", "train", -2.0), ("right", "train", 2.0), ("far", "test", 4.0)]
        )
    ),
    columns=("x [m]", "steps [1]"), action_size=1, action_low=-1.0, action_high=1.0, horizon=8,
    step_s=1.0, return_target=-5.0, return_scale=10.0, env=lambda task: Line(task.goal[0]),
    scripts={"there": there}, ends_early=False,
)
"""
ENTRIES = """
schema: 1
families: {line: {module: 'mine:family'}}
datasets:
  first:
    {version: "1.0.0", family: line, horizon: 8, seed: 1, block: 10, license: CC0-1.0,
     behaviour: {script: there, noise: 0.05}, episodes: {random: 10, expert: 40}, reference: 10,
     tta: {default: {episodes: 5}}}
  again:
    {version: "1.0.0", family: line, horizon: 8, seed: 2, block: 10, license: CC0-1.0,
     behaviour: {bundle: runs/mine, start: infer, rungs: 6, noise: 0.02}, reference: 10,
     episodes: {random: 10, medium: 10, expert: 25, history: 12}}
  alone:
    {version: "1.0.0", family: line, horizon: 8, seed: 2, block: 10, license: CC0-1.0,
     behaviour: {bundle: runs/mine}, episodes: {random: 5, expert: 5}}
"""


@pytest.mark.slow
def test_a_policy_of_ones_own_family_collects_anew(tmp_path: Path) -> None:
    """From an empty folder: script, training, calibration, and one hash with 0, 1 and 2 workers."""
    (tmp_path / "mine.py").write_text(MODULE)
    (tmp_path / "datasets.yaml").write_text(ENTRIES)

    def run(words: str, code: int = 0) -> str:
        done = subprocess.run([sys.executable, "-m", *words.split()], cwd=tmp_path, text=True,
                              env=dict(os.environ), capture_output=True, check=False)  # fmt: skip
        assert done.returncode == code, done.stderr
        return done.stdout if "--json" in words else done.stdout + done.stderr

    run("mpdt.data.cli collect first --workers 0 -q")
    run("mpdt.train.cli --data first.h5 --preset smoke --method MPDT-ones --name mine --quiet "
        "--multitask.steps 300 --adapt infer")  # fmt: skip
    told = run("mpdt.data.cli plan alone", code=2)
    assert "no prompt for the task far" in told and "found prompts in infer, none" in told
    run("mpdt.data.cli calibrate again --workers 0")
    hashes = set()
    for workers in (0, 1, 2):
        told = run(f"mpdt.data.cli collect again --workers {workers} -o w{workers}.h5 --json -q")
        hashes.add(json.loads(told)["content_hash"])
    assert len(hashes) == 1
    found = json.loads(run("mpdt.data.cli verify w2.h5 --replay all --json"))
    outcomes = {one["id"]: one["outcome"] for one in found["checks"]}
    assert outcomes["replay"] == "PASS" and "FAIL" not in outcomes.values()
