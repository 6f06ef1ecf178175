"""Policies that are not ours: the same seeds and table, one clear error for whatever they do."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

import mpdt
from mpdt.data.sim.actors import UniformPolicy, ZeroPolicy
from mpdt.data.spec.tasks import get_family
from mpdt.data.store.reader import open_dataset
from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import CHECKS, verify
from mpdt.errors import DataError, MpdtError, ShapeError, UsageError
from mpdt.train.evaluate.rollout import EvaluationSettings, evaluate
from mpdt.train.evaluate.score import MEAN
from mpdt.train.run.judge_outside import judge_outside
from mpdt.train.run.progress import Progress

from .command import call

MODULE = '''
"""Policies as somebody else writes them."""
import numpy as np

CALLS = []

def zero(observations, rewards, starts, task):
    CALLS.append((observations.shape, rewards.tolist(), starts.tolist(), task))
    return np.zeros((len(observations), 6))

class Own:
    """Keeps a state: counts the steps of its episodes."""
    def __init__(self):
        self.steps = 0
    def act(self, observations, rewards, starts, task):
        self.steps = 0 if starts.all() else self.steps + 1
        assert not starts.any() or starts.all()
        return np.full((len(observations), 6), 0.1 * self.steps)

own = Own()
number = 3

def late(observations, *_):
    from beside import SIZE
    print("imported")
    return np.zeros((len(observations), SIZE))

def wanders(observations, *_):
    import os
    os.chdir("/")
    return np.zeros((len(observations), 6))

def raises(observations, rewards, starts, task):
    if not starts.all():
        raise RuntimeError("out of ideas")
    return np.zeros((len(observations), 6))

def leaves(*_):
    raise SystemExit(3)

def nothing(*_):
    pass

def narrow(observations, *_):
    return np.zeros((len(observations), 5))

def one_row(observations, *_):
    return np.zeros(6)

def words(observations, *_):
    return [["left"] * 6] * len(observations)

def imaginary(observations, *_):
    return np.zeros((len(observations), 6), complex)

def ragged(observations, *_):
    return [[0.0]] + [[0.0] * 6] * (len(observations) - 1)

def nan_later(observations, rewards, starts, task):
    actions = np.zeros((len(observations), 6))
    if not starts.all():
        actions[1, 2] = np.nan
    return actions

def infinite(observations, *_):
    return np.full((len(observations), 6), np.inf)

def wants_more(observations, rewards, starts, task, mood):
    pass

def meddles(observations, rewards, starts, task):
    observations[:] = np.nan
    rewards[:] = np.nan
    return np.zeros((len(observations), 6))
'''
SETTINGS = EvaluationSettings(episodes=3, horizon=4, seed=5)


@pytest.fixture
def theirs(tmp_path, monkeypatch):
    """The working folder with a module of theirs."""
    (tmp_path / "theirs.py").write_text(MODULE)
    (tmp_path / "broken.py").write_text("import nothing_of_that_name")
    (tmp_path / "shy.py").write_text("raise SystemExit('not today')")
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for name in ("theirs", "broken", "shy"):
        sys.modules.pop(name, None)


def judged(policy, file, keep=None, settings=SETTINGS, reads=None):
    return judge_outside(policy, str(file), settings, Progress(quiet=True), keep, reads)


def rows(results, method):
    return {s["task"]: s for s in results["scores"] if s["method"] == method}


def test_the_table_is_that_of_ours(theirs, tiny_file):
    """A policy that does nothing earns what zero action earns; the trivial rows are as by hand."""
    results = judged("theirs:zero", tiny_file)
    assert {s["block"] for s in results["scores"]} == {"train"}, "both blocks are the same episodes"
    found, zero = rows(results, "theirs:zero"), rows(results, "zero action")
    assert list(found) == ["forward", "backward", MEAN]
    for task in found:
        same = ("mean", "low", "high", "num_episodes")
        assert [found[task][key] for key in same] == [zero[task][key] for key in same]
    family = get_family("cheetah_dir")
    for name, actor in {"zero action": ZeroPolicy(6), "random": UniformPolicy(6, -1, 1)}.items():
        by_hand = evaluate(actor, family, family.tasks, {}, 4, 3, 5)
        assert rows(results, name)["forward"]["mean"] == by_hand.returns[0].mean()
    assert found["forward"]["beats_trivial"] is False
    assert set(rows(results, "expert")) == set(found)


def test_who_judges_says_what_was_read(theirs, tiny_file):
    """Of test tasks alone; the versions that judged stand there as well."""
    settings = msgspec.structs.replace(SETTINGS, blocks=("test",))
    results = judged("theirs:zero", tiny_file, settings=settings, reads="X")
    assert {s["reads"] for s in rows(results, "theirs:zero").values()} == {"X"}
    assert results["versions"]["mpdt"] == mpdt.__version__
    both = rows(judged("theirs:zero", tiny_file, reads="X"), "theirs:zero")
    assert {s.get("reads") for s in both.values()} == {None}, "these are training tasks"


def test_a_policy_may_import_print_and_go_elsewhere(theirs, tiny_file, capsys):
    """What it prints is no part of the results; what is kept lies where it was asked for."""
    (theirs / "beside.py").write_text("SIZE = 6")
    judged("theirs:late", tiny_file)
    out, error = capsys.readouterr()
    assert out == "" and "imported" in error
    judged("theirs:wanders", tiny_file, keep=Path("kept.h5"))
    assert (theirs / "kept.h5").exists()


def test_what_a_callable_is_given(theirs, tiny_file):
    judged("theirs:zero", tiny_file)
    calls = sys.modules["theirs"].CALLS
    assert len(calls) == 2 * 4, "task by task, step by step"
    assert [task for *_, task in calls] == ["forward"] * 4 + ["backward"] * 4
    assert {shape for shape, *_ in calls} == {(3, 20)}
    for first, *rest in (calls[:4], calls[4:]):
        assert first[1] == [0, 0, 0] and first[2] == [True] * 3
        assert all(any(paid) and starts == [False] * 3 for _, paid, starts, _ in rest)


def test_a_state_of_its_own_and_what_it_may_not_touch(theirs, tiny_file):
    results = judged("theirs:own.act", tiny_file, settings=EvaluationSettings(
        episodes=3, horizon=4, seed=5, max_rows=2))  # fmt: skip
    assert rows(results, "theirs:own.act")["forward"]["mean"]
    found = rows(judged("theirs:meddles", tiny_file), "theirs:meddles")
    assert found["forward"]["mean"] == rows(results, "zero action")["forward"]["mean"]


@pytest.mark.parametrize(("words", "error", "text"), [
    ("theirs", UsageError, "cannot read 'theirs'"),
    ("theirs:", UsageError, "expected module:function"),
    ("no_such_module:act", UsageError, "ModuleNotFoundError: No module named 'no_such_module'"),
    ("broken:act", UsageError, "broken: cannot be imported: ModuleNotFoundError"),
    ("shy:act", UsageError, "shy: cannot be imported: SystemExit: not today"),
    ("theirs:zer", UsageError, "did you mean 'zero'"),
    ("theirs:number", UsageError, "cannot be called; .* found int"),
    ("theirs:Own", UsageError, "cannot be called"),
    ("theirs:raises", UsageError, "theirs:raises, task forward, step 1: .*RuntimeError: out of"),
    ("theirs:leaves", UsageError, "step 0: the policy failed: SystemExit: 3"),
    ("theirs:wants_more", UsageError, "step 0: the policy failed: TypeError: .*mood"),
    ("theirs:nothing", ShapeError, r"expected shape \(3, 6\), found NoneType of shape \(\)"),
    ("theirs:narrow", ShapeError, r"found ndarray of shape \(3, 5\)"),
    ("theirs:one_row", ShapeError, r"found ndarray of shape \(6,\)"),
    ("theirs:words", ShapeError, "actions that are no real numbers"),
    ("theirs:imaginary", ShapeError, "found complex128"),
    ("theirs:ragged", UsageError, "step 0: the policy failed: ValueError"),
    ("theirs:nan_later", DataError, "task forward, step 1: an action is not a number.* row 1"),
    ("theirs:infinite", DataError, "step 0: an action is not a number"),
])  # fmt: skip
def test_bad_callables(theirs, tiny_file, words, error, text):
    before = list(sys.path)
    with pytest.raises(error, match=text) as caught:
        judged(words, tiny_file, theirs / "kept.h5")
    assert isinstance(caught.value, MpdtError) and "\n" not in caught.value.message()
    assert sys.path == before and not (theirs / "kept.h5").exists()


def test_its_episodes_are_kept_and_their_returns_are_the_table(theirs, planned_file):
    results = judged("theirs:own.act", planned_file, theirs / "kept.h5")
    kept = open_dataset(theirs / "kept.h5")
    assert kept.num_episodes == 6 and set(kept.slices) == {"policy", "train", "test"}
    for row, task in enumerate(kept.tasks.names):
        returns = kept.episodes.returns[kept.episodes.task == row]
        assert returns.mean() == rows(results, "theirs:own.act")[task]["mean"]
    report = verify(kept.path, replay="all")
    assert report.count(Outcome.PASS) == len(CHECKS) - 1 and report.count(Outcome.NONE) == 1
    assert kept.spec["seed"] == 5 and kept.spec["horizon"] == 4
    (step,) = kept.lineage
    assert step["verb"] == "evaluate" and step["from"] == [open_dataset(planned_file).content_hash]
    assert results["policy"]["fingerprint"] == kept.policies.hashes[0].tobytes().hex()
    judged("theirs:own.act", planned_file, theirs / "kept.h5")  # its own file may be replaced
    with pytest.raises(DataError, match="something else is there"):
        judged("theirs:zero", planned_file, theirs / "kept.h5")


def test_what_it_reached_stands_in_the_file(theirs, planned_file):
    """At the horizon of the data; at another one nobody knows what the expert would earn."""
    settings = EvaluationSettings(episodes=2, seed=5)
    results = judged("theirs:own.act", planned_file, theirs / "kept.h5", settings)
    levels = open_dataset(theirs / "kept.h5").policies.levels.tolist()
    table = rows(results, "theirs:own.act")
    assert levels == [np.float32(table[task]["normalised"]) for task in ("forward", "backward")]
    judged("theirs:own.act", planned_file, theirs / "short.h5")
    assert np.isnan(open_dataset(theirs / "short.h5").policies.levels).all()


def test_the_command(theirs, tiny_file, capsys):
    words = ["evaluate", "--policy", "theirs:zero", "--data", tiny_file, "-q"]
    asked = ["--evaluation.episodes", "2", "--evaluation.horizon", "3"]
    assert call(*words, *asked, "--json") == 0
    results = json.loads(capsys.readouterr().out)
    assert results["evaluation"]["episodes"] == 2 and results["data"]["horizon"] == 3
    assert np.isfinite(rows(results, "theirs:zero")[MEAN]["mean"])
    assert call(*words, *asked) == 0
    out = capsys.readouterr().out
    assert "Training tasks: return" in out and "prompt" not in out
    assert call(*words, "runs/x") == 2
    assert call(*words[:4], f"{tiny_file}:few") == 2
    assert "a slice chooses episodes" in capsys.readouterr().err
