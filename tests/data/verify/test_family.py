"""check-family: a sound family passes, and each rule notices the one thing that breaks it."""

from __future__ import annotations

import json
import random
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from own_families import TASKS, Line, forgotten, line, make, there

import mpdt.testing
from mpdt.data.cli import main
from mpdt.data.sim.single import EnvBatch
from mpdt.data.verify import family as module
from mpdt.data.verify.family import check_family
from mpdt.data.verify.finding import Outcome

SHARED: list[float] = []


class Broken(Line):
    """Breaks the rule `how`."""

    def __init__(self, how: str, goal: float) -> None:
        super().__init__(goal)
        self.how, self.lived, self.index = how, 0, len(SHARED)
        SHARED.append(0.0)

    def reset(self, **given: Any) -> Any:
        if self.how == "seed":
            given["seed"] = None
        observation, info = super().reset(**given)
        self.lived += 1
        if self.how == "reset" and self.lived > 1:
            self.at = observation[0] = 0.5
        if self.how == "goal":
            observation[1] = self.goal
        return observation, info

    def step(self, action: Any) -> Any:
        if self.how == "numpy.random":
            np.random.normal()  # noqa: NPY002
        if self.how == "random":
            random.random()
        if self.how == "torch":
            sys.modules["torch"].rand(1)
        SHARED[self.index] = self.at
        if self.how == "neighbours" and self.steps == 4:
            self.at += SHARED[self.index - 1]  # of the row before
        observation, reward, over, cut, info = super().step(action)
        if self.how == "goal":
            observation[1] = self.goal
        if self.how == "bounds" and action[0] == 1.0 and self.steps == 3:
            observation[0] = np.inf
        if self.how == "zero":
            observation[0] = -0.0 if self.index % 2 else 0.0
        if self.how == "reward":
            reward += self.index
        if self.how == "late":
            over = over or (self.steps == 8 and self.index % 2 == 0)
        return observation, reward, over or (self.how == "ends" and self.steps == 5), cut, info


def batch_that_ends(family: Any, tasks: Any, options: Any) -> EnvBatch:
    """Nobody looks at what a batch of one's own answers."""
    made = {"env": lambda task: Broken("ends", task.goal[0]), "batch": None, "ends_early": True}
    return EnvBatch(replace(family, **made), tasks, options)


def rules(how: str = "", **changes: Any) -> dict[str, Any]:
    changes = {"env": lambda task: Broken(how, task.goal[0])} | changes if how else changes
    return {one.id: one for one in check_family(line(**changes), worker=False)}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SECONDS", 0.002)


@pytest.mark.parametrize("how", ["", "sound"])
def test_a_sound_family_passes(how: str) -> None:
    found = rules(how)
    assert {one.outcome for one in found.values()} == {Outcome.PASS}
    assert "3 tasks, 216 steps" in found["stepping"].text  # 3 rows of 8 steps, thrice
    assert "times a plain loop" in found["speed"].text


@pytest.mark.parametrize(
    ("how", "rule", "told", "changes"),
    [
        ("seed", "seed", "task left, reset, row 0: another x [m]", {}),
        ("reset", "reset", "task left, reset, row 0: another x [m]", {}),
        ("zero", "seed", "task left, step 0, row 0: another sign of zero", {}),
        ("reward", "seed", "task left, step 0, row 0: another reward", {}),
        ("late", "seed", "task left, step 7, row 0: another end", {"ends_early": True}),
        ("neighbours", "neighbours", "task left, step 4, row 0: another", {}),
        ("numpy.random", "globals", "it draws from numpy.random: use env.np_random", {}),
        ("random", "globals", "it draws from random: use env.np_random", {}),
        ("torch", "globals", "it draws from torch: use env.np_random", {}),
        ("ends", "stepping", "task left, step 4: the episode ends here", {"ends_early": False}),
        ("", "endings", "task left, step 4, row 0: it ends",
         {"ends_early": False, "env": None, "batch": batch_that_ends}),
        ("goal", "tasks", "reset: steps [1] is number 0 of the goal", {}),
        ("bounds", "stepping", "task left, step 2: a number of the observation is not", {}),
        ("", "tasks", "tasks left and right are the same", {"env": lambda task: Line(1.0)}),
        ("", "tasks", "tasks right and far are the same",
         {"env": lambda task: Line(-2.0 if task.name == "left" else 4.0)}),
        ("", "scripts", "script away, task left: returns -",
         {"scripts": {"away": lambda seen, goals: -there(seen, goals)}}),
        ("", "scripts", "script odd, task left, step 0: another answer",
         {"scripts": {"odd": lambda seen, goals: there(seen, goals) * len(SHARED.append(1)
                      or SHARED) / 1e4}}),
        ("", "scripts", "script none, step 0: the script's actions are none",
         {"scripts": {"none": lambda seen, goals: np.zeros((1, 3))}}),
        ("", "scripts", "script fails, step 0: the script raised; found ZeroDivisionError",
         {"scripts": {"fails": lambda seen, goals: 1 / 0}}),
    ],
)  # fmt: skip
def test_each_rule_notices(how: str, rule: str, told: str, changes: dict[str, Any]) -> None:
    if how == "torch":
        pytest.importorskip("torch")
    found = rules(how, **changes)
    assert found[rule].outcome is Outcome.FAIL and told in found[rule].text
    if rule == "stepping":
        assert {one.outcome for id, one in found.items() if id != rule} == {Outcome.SKIP}


def test_another_process_is_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if it played the rows from behind."""

    def elsewhere(function: Any, runs: Any, workers: int) -> Any:
        return [function(run.rows(slice(None, None, -1))) for run in runs]

    monkeypatch.setattr(module, "map_blocks", elsewhere)
    found = {one.id: one for one in check_family(line())}["worker"]
    assert found.outcome is Outcome.FAIL
    assert "here and in another process: task left, reset, row 0: another x" in found.text


def test_the_simulator_gets_its_options() -> None:
    """`line` ends beyond 3 where it is told to; this one says that it does not."""
    found = check_family(line(ends_early=False), options={"ends": True}, worker=False)[0]
    assert found.outcome is Outcome.FAIL and "the episode ends here" in found.text


def test_as_a_test_it_raises_what_is_broken() -> None:
    assert {one.outcome for one in mpdt.testing.check_family(line())} == {Outcome.PASS}
    with pytest.raises(AssertionError, match=r"\[FAIL\] globals .*it draws from random"):
        mpdt.testing.check_family(line(env=lambda task: Broken("random", task.goal[0])))


def test_a_goal_that_is_no_secret_may_be_shown() -> None:
    shown = {"goal_hidden": False, "has_success": True}
    assert rules("goal", **shown)["tasks"].outcome is Outcome.PASS
    assert rules("goal", hidden_columns=(1,))["tasks"].outcome is Outcome.PASS


def test_who_is_not_exact_is_not_held_to_bytes() -> None:
    found = rules("seed", exact=False)
    assert found["seed"].outcome is Outcome.SKIP and "exact is false" in found["seed"].text
    assert found["endings"].outcome is Outcome.PASS
    calls: list[int] = []

    def uneven(seen: Any, goals: Any) -> Any:
        calls.append(0)
        return there(seen, goals) * (1 - len(calls) % 3 / 4)

    for exact, outcome in ((True, Outcome.FAIL), (False, Outcome.PASS)):
        assert rules(scripts={"uneven": uneven}, exact=exact)["scripts"].outcome is outcome


def test_batches_pass_too() -> None:
    def vector(tasks: Any) -> Any:
        return gymnasium.vector.SyncVectorEnv([lambda task=task: make(task) for task in tasks])

    found = rules(env=None, vector=vector)
    assert {one.outcome for one in found.values()} == {Outcome.PASS}


def test_the_verb_tells_and_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "theirs.py").write_text("from own_families import line\nfamily = line\n")
    text = "schema: 1\nfamilies:\n  {}: {{module: 'theirs:family'}}\ndatasets: {{}}\n"
    (tmp_path / "datasets.yaml").write_text(text.format("mine"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(module, "map_blocks", lambda function, items, workers: map(function, items))
    with forgotten():
        assert main(["check-family", "mine", "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert told["summary"] == "10 passed" and told["module"] == "theirs:family"
        assert main(["check-family", "mine", "--seed", "-1"]) == 2
        assert "--seed: a negative seed" in capsys.readouterr().err
        assert main(["check-family", "nobody"]) == 2
        assert "unknown family 'nobody'" in capsys.readouterr().err
        (tmp_path / "datasets.yaml").write_text(text.format("ml10"))
        assert main(["check-family", "another"]) == 2
        assert "families.ml10: ml10: mpdt has a family of that" in capsys.readouterr().err
        monkeypatch.setattr("own_families.Line.step", lambda self, action: None)
        assert main(["check-family", "mine"]) == 1
        assert "1 of 10 rules: stepping" in capsys.readouterr().err


def test_the_tasks_are_those_of_the_file() -> None:
    assert [task.name for task in module._some_tasks(line())] == [task.name for task in TASKS]
