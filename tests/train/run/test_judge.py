"""The rows beside the trained policy: who is run, on which seeds, and what is said about it.

The tiny file: two tasks of role both; expert episodes return 18 to 27, its references are
random -1 and -2, expert 9 and 8; horizon 9.
"""

import math
from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import torch

from mpdt.data.reference import References
from mpdt.data.sim.actors import UniformPolicy, ZeroPolicy
from mpdt.data.slices.sampler import SamplerSettings
from mpdt.model.prompts import AdaptedPrompts, PromptSettings, SharedPrompt
from mpdt.model.returns import ReturnTable
from mpdt.train.adapt import candidates
from mpdt.train.adapt.candidates import Candidates
from mpdt.train.evaluate.rollout import Evaluation, evaluate
from mpdt.train.evaluate.score import MEAN
from mpdt.train.fit.data import Material, load_material
from mpdt.train.fit.trained import Trained
from mpdt.train.run import bench
from mpdt.train.run.bench import Bench
from mpdt.train.run.judge import Judge
from mpdt.train.run.presets import smoke
from mpdt.train.run.progress import Progress

ONE = SharedPrompt(PromptSettings(kind="shared", length=1), 2, 4, 1.0)


def make_judge(tiny_file, horizon=0, returns="constant"):
    config = smoke()
    config = msgspec.structs.replace(
        config,
        evaluation=msgspec.structs.replace(config.evaluation, horizon=horizon, seed=3),
        adapt=msgspec.structs.replace(config.adapt, returns=returns),
    )
    material = load_material(str(tiny_file), "expert")
    returns = ReturnTable(*(torch.ones(2) for _ in range(4)))
    trained = Trained(None, ONE, returns, material, {}, {})
    return Judge(trained, config, Progress(quiet=True))


def test_trivial_policies_are_run_on_the_evaluation_seeds_at_any_horizon(tiny_file):
    """The simulator, 4 steps: equal to running both by hand; nothing is taken from the file."""
    subject = make_judge(tiny_file, horizon=4)
    subject.bench.settings = msgspec.structs.replace(subject.bench.settings, constants=False)
    scores = subject.bench.references("train", (0, 1))
    found = {(s.method, s.task): s for s in scores}
    family = subject.trained.material.family
    by_hand = {
        "zero action": ZeroPolicy(6),
        "random": UniformPolicy(6, -1.0, 1.0),
    }
    for method, controller in by_hand.items():
        result = evaluate(controller, family, family.tasks, {}, 4, 2, seed=3)
        for task, returns in zip(("forward", "backward"), result.returns, strict=True):
            score = found[method, task]
            assert score.mean == returns.mean() and score.num_episodes == 2
            assert (score.low, score.high) == (returns.min(), returns.max())
    assert found["random", "forward"].mean != found["zero action", "forward"].mean
    assert all(math.isnan(found["expert", task].mean) for task in ("forward", "backward", MEAN))
    assert math.isnan(found["best constant", MEAN].mean)


class Played:
    """Stands in for the simulator: zero action earns 1, all others 5, give or take 0.5."""

    def __init__(self):
        self.runs = []

    def __call__(self, controller, family, tasks, *_):
        name = type(controller).__name__
        self.runs.append((name, tuple(task.name for task in tasks)))
        middle = 1.0 if name == "ZeroPolicy" else 5.0
        returns = np.full((len(tasks), 2), middle) + np.array([-0.5, 0.5])
        return Evaluation(tuple(task.name for task in tasks), returns, returns.astype(int), None)


@pytest.fixture
def played(monkeypatch):
    """`best constant` is zero action unless a test says otherwise."""
    fake = Played()
    monkeypatch.setattr(bench, "evaluate", fake)
    monkeypatch.setattr(Bench, "_constant_action", lambda self: np.zeros(6, np.float32))
    monkeypatch.setattr(Candidates, "controller", lambda self, *_: SimpleNamespace())
    monkeypatch.setattr(Candidates, "_statistics", lambda self: None)
    monkeypatch.setattr(Candidates, "_adapt", lambda self, *_: None)
    monkeypatch.setattr(Candidates, "_start", lambda self, _: AdaptedPrompts(ONE, "cross", 2))
    return fake


@pytest.fixture
def judged(played, tiny_file):
    def scores(**options):
        return make_judge(tiny_file, **options).scores()

    return scores


def test_a_trivial_policy_is_run_on_a_task_once(judged, played):
    """Roles are `both`, and the best constant is zero action: zero, random and three MPDT."""
    scores = judged()
    assert [name for name, _ in played.runs] == [
        "ZeroPolicy", "UniformPolicy", "SimpleNamespace", "SimpleNamespace", "SimpleNamespace",
    ]  # fmt: skip
    for block in ("train", "test"):
        means = {s.method: s.mean for s in scores if s.block == block and s.task == MEAN}
        assert means["zero action"] == means["best constant"] == 1.0 and means["random"] == 5.0


def test_other_test_tasks_are_run_by_themselves(judged, played, monkeypatch):
    load = load_material
    monkeypatch.setitem(
        globals(), "load_material", lambda *a: replace(load(*a), train_rows=(0,), test_rows=(1,))
    )
    judged()
    assert ("ZeroPolicy", ("forward",)) in played.runs and (
        "ZeroPolicy",
        ("backward",),
    ) in played.runs


def test_the_constant_action_is_the_one_in_the_file(tiny_file):
    subject = make_judge(tiny_file)
    assert subject.bench._constant_action().tolist() == [0, 1, 0, 0, 0, 0]
    material = subject.trained.material
    tasks = material.dataset.tasks
    unknown = replace(tasks, references=tuple(References(r.by_name) for r in tasks.references))
    bare = replace(material, dataset=replace(material.dataset, tasks=unknown))
    subject.bench.material = bare
    assert subject.bench._constant_action() is None


def test_the_expert_is_the_reference_in_the_file(judged):
    """9 and 8, known to 0.5 from 16 episodes each."""
    for block in ("train", "test"):
        expert = {s.task: s for s in judged() if s.method == "expert" and s.block == block}
        assert (expert["forward"].mean, expert["backward"].mean) == (9.0, 8.0)
        assert expert["forward"].num_episodes == 16 and expert[MEAN].num_episodes == 32
        assert expert["forward"].high == 9.0 + 1.96 * 0.5
        assert expert["forward"].success is None, "the cheetah has no success"


def test_mpdt_gets_a_verdict_and_references_do_not(judged):
    """5 +- 0.5 lies above zero action's 1 +- 0.5, but not above random's 5 +- 0.5."""
    scores = judged()
    assert {s.beats_trivial for s in scores if s.method.startswith("MPDT")} == {False}
    assert {s.beats_trivial for s in scores if not s.method.startswith("MPDT")} == {None}


@pytest.mark.parametrize(("returns", "read"), [("constant", "X"), ("decrement", "X+rewards")])
def test_what_adaptation_read_is_said(judged, returns, read):
    said = {s.method: s.reads for s in judged(returns=returns) if s.block == "test"}
    assert said["MPDT from cross, adapted"] == read
    assert said["MPDT P_c o mean P_k, not adapted"] == "nothing" and said["random"] is None


def test_knowing_the_task_is_told_where_only_the_goal_is_unseen(judged, monkeypatch):
    goals = SimpleNamespace(training_key=None, held_out_key=None, count=50, held_out=5)
    monkeypatch.setattr(Material, "goals", property(lambda self: goals))
    said = {s.method: s.reads for s in judged() if s.block == "test"}
    assert said["MPDT own prompts"] == "task id"


def test_intervals_are_over_goals_where_episodes_share_them(judged, monkeypatch):
    """One goal however many episodes: nothing can be resampled, and nothing beats anything."""
    monkeypatch.setattr(Material, "num_goals", lambda self, block: 1 if block == "test" else None)
    ours = [s for s in judged() if s.method.startswith("MPDT")]
    assert {(s.block, np.isnan(s.low), s.beats_trivial) for s in ours} == {
        ("train", False, False), ("test", True, None)
    }  # fmt: skip


def test_statistics_show_episodes_evenly(tiny_file, monkeypatch):
    """X is covered once per step, so the source must not favour the beginning of episodes."""
    subject = make_judge(tiny_file)
    monkeypatch.setattr(
        candidates,
        "source_statistics",
        lambda policy, prompts, sampler, *_: sampler.batch(0).starts,
    )
    even, biased = (
        Candidates(subject.trained, msgspec.structs.replace(
            subject.config, sampler=SamplerSettings(per_task=64, start_bias=bias)
        ))._statistics() for bias in (0, 1000)
    )  # fmt: skip
    assert even.any() and np.array_equal(even, biased)
