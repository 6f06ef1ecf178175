"""Environments of one's own families: the same numbers as a plain loop, and nothing believed."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit
from own_families import TASKS, Line, forgotten, line, make

from mpdt.data.sim.actors import UniformPolicy
from mpdt.data.sim.gym import make as make_gym
from mpdt.data.sim.play import run_block
from mpdt.data.sim.simulators import make_batch
from mpdt.data.spec.own import register_family
from mpdt.errors import MpdtError, SimulatorError, SpecError, UsageError
from mpdt.seeding import SeedKey


def vector(tasks: Any, mode: Any = AutoresetMode.NEXT_STEP, **options: Any) -> SyncVectorEnv:
    return SyncVectorEnv([lambda task=task: make(task, **options) for task in tasks],
                         autoreset_mode=mode)  # fmt: skip


def keys(family: Any, rows: int = 3) -> list[SeedKey]:
    return [SeedKey(5, family.id, 0, 0, 0, row) for row in range(rows)]


def played(family: Any, horizon: int = 8, **options: Any) -> Any:
    env = make_batch(family, [family.tasks[1]] * 3, options)
    policy = UniformPolicy(1, -1.0, 1.0)
    return run_block(env, policy, keys(family), horizon=horizon, quality=0, progress=0.0)


@pytest.mark.parametrize("ends", [False, True])
def test_rows_are_what_a_plain_loop_gives(ends: bool) -> None:
    families = [line(horizon=40), line(horizon=40, env=None, vector=vector)]
    one, two = (played(family, 40, ends=ends) for family in families)
    assert {episode.length < 40 for episode in one} == ({True} if ends else {False})
    for key, episode, same in zip(keys(families[0]), one, two, strict=True):
        env = make(TASKS[1], ends)
        observations = [env.reset(seed=key.env_seed())[0]]
        rewards = []
        for action in episode.actions:
            observation, reward, *_ = env.step(action)
            observations.append(observation)
            rewards.append(reward)
        assert (np.array(observations, np.float32) == episode.observations).all()
        assert (np.array(rewards, np.float32) == episode.rewards).all()
        assert episode.terminations.tolist()[-1] == ends and not episode.terminations[:-1].any()
        assert episode.goal.tolist() == [2.0] and episode.successes is None
        assert (same.observations == episode.observations).all()
        assert (same.rewards == episode.rewards).all() and same.length == episode.length


class Odd(Line):
    """Does `what` at its third step, of those that are counted from 0."""

    def __init__(self, what: str, **spaces: Any) -> None:
        super().__init__(2.0)
        self.what = what
        vars(self).update(spaces)

    def reset(self, **given: Any) -> Any:
        observation, info = super().reset(**given)
        if self.what == "raises in reset":
            raise OSError("no display")
        odd = {"reset NaN": observation * np.nan, "reset list": [0.0, 0.0],
               "reset shape": np.zeros(3), "reset text": np.array(["a", "b"])}  # fmt: skip
        return odd.get(self.what, observation), info

    def step(self, action: Any) -> Any:
        observation, reward, over, cut, info = super().step(action)
        if self.steps != 4:
            return observation, reward, over, cut, info
        if self.what == "raises":
            raise ValueError("at the\nborder")
        if self.what == "four":
            return observation, reward, over, info
        odd = {"shape": np.zeros(3), "NaN": observation * np.nan, "list": [1.0, 2.0],
               "type": observation.astype(np.float32), "scalar": np.float64(1.0)}  # fmt: skip
        pay = {"reward inf": float("inf"), "reward array": np.zeros(1), "reward none": None}
        no_success = {} if self.what == "no success" else info
        return (odd.get(self.what, observation), pay.get(self.what, reward), over,
                self.what == "cut", no_success)  # fmt: skip


BOX = gymnasium.spaces.Box
ODD: list[tuple[str, dict[str, Any], str]] = [
    ("raises in reset", {}, "right, reset: the environment raised; found OSError: no display"),
    ("reset NaN", {}, "right, reset: a number of the observation is not finite"),
    ("reset list", {}, "right, reset: the observation is no array of numbers; found list"),
    ("reset shape", {}, r"right, reset: an observation of another shape; expected \(2,\), found"),
    ("reset text", {}, "right, reset: the observation is no array of numbers"),
    ("raises", {}, "step 3: the environment raised; found ValueError: at the border"),
    ("four", {}, "step 3: the environment raised; found ValueError: not enough values"),
    ("shape", {}, r"step 3: an observation of another shape; expected \(2,\), found \(3,\)"),
    ("scalar", {}, r"step 3: an observation of another shape; expected \(2,\), found \(\)"),
    ("type", {}, "step 3: an observation of another type than at reset; expected float64"),
    ("NaN", {}, "step 3: a number of the observation is not finite"),
    ("reward inf", {}, "step 3: a number of the reward is not finite; found inf"),
    ("reward array", {}, "step 3: the reward is no number; found ndarray"),
    ("reward none", {}, "step 3: the reward is no number; found NoneType"),
    ("no success", {"has_success": True}, "step 3: the environment raised; found KeyError"),
    ("cut", {}, "step 3: the environment has a time limit of its own; found 4 steps"),
]


@pytest.mark.parametrize(("what", "changes", "told"), ODD, ids=[what for what, _, _ in ODD])
def test_an_odd_environment_is_named_with_task_and_step(
    what: str, changes: dict[str, Any], told: str
) -> None:
    family = line(env=lambda task: Odd(what), **changes)
    with pytest.raises(SimulatorError, match=told) as caught:
        played(family)
    assert caught.value.exit_code == 3 and "\n" not in caught.value.message()


@pytest.mark.parametrize(
    ("env", "told"),
    [
        (lambda task: 1 / 0, "making it: the environment raised; found ZeroDivisionError"),
        (lambda task: 3, "making it: no gymnasium environment; found int"),
        (lambda: 3, "making it: the environment raised; found TypeError"),
        ("own_families:absent", "making it: the environment raised; found AttributeError"),
        ("absent:make", "making it: the environment raised; found ModuleNotFoundError"),
        (lambda task: Odd("", observation_space=BOX(-1, 1, (3,))), "another observation space"),
        (lambda task: gymnasium.Env(), "another observation space than the family's; expected a"),
        (lambda task: Odd("", observation_space=gymnasium.spaces.Discrete(3)), "another obs"),
        (lambda task: Odd("", action_space=gymnasium.spaces.Discrete(3)), "another action space"),
        (lambda task: Odd("", action_space=BOX(-1, 1, (2,))), r"a Box of shape \(1,\)"),
        (lambda task: Odd("", action_space=BOX(-2, 1, (1,))), "other action bounds"),
    ],
)
def test_what_is_no_environment_of_the_family(env: Any, told: str) -> None:
    with pytest.raises(SimulatorError, match=told):
        played(line(env=env))


@pytest.mark.parametrize(
    ("make_vector", "told"),
    [
        (lambda tasks: vector(tasks[:2]), "another number of rows; expected 3, found 2"),
        (lambda tasks: vector(tasks, AutoresetMode.SAME_STEP), "start anew in the step that ends"),
        (lambda tasks: make(tasks[0]), "no gymnasium VectorEnv; found Line"),
        (lambda tasks: SyncVectorEnv([lambda: TimeLimit(make(tasks[0]), 4)] * 3), "limit of its"),
        (lambda tasks: SyncVectorEnv([lambda: Odd("NaN")] * 3), "step 3: a number of the obs"),
        (lambda tasks: SyncVectorEnv([lambda: Odd("raises")] * 3), "step 3: the environment rais"),
    ],
)
def test_an_odd_vector_environment(make_vector: Any, told: str) -> None:
    with pytest.raises(SimulatorError, match=told):
        played(line(env=None, vector=make_vector))


def test_options_goals_and_steps_are_the_familys() -> None:
    family = line()
    with pytest.raises(SpecError, match="unknown simulator option 'wind'"):
        make_batch(family, TASKS, {"wind": 1.0})
    env = make_batch(family, TASKS[:1], {})
    with pytest.raises(UsageError, match="reset comes before the first step"):
        env.step(np.zeros((1, 1), np.float32))
    with pytest.raises(UsageError, match=r"another goal than the task's; expected \(-2.0,\)"):
        env.reset(keys(family, 1), [np.array([3.0])])
    with pytest.raises(SimulatorError, match="simulator of this family is not here") as caught:
        make_batch(line(name="gone", env=None, module="a:b"), TASKS, {})
    assert "families: {gone:" in caught.value.hint


def test_as_a_gymnasium_environment_it_has_the_familys_horizon_and_hides() -> None:
    with forgotten():
        register_family(line(hidden_columns=(1,)))
        env = make_gym("line", "far")
        assert env.reset(seed=3)[0][1] == 0
        steps = [env.step(np.ones(1, np.float32)) for _ in range(8)]
        assert [step[3] for step in steps] == [False] * 7 + [True]
        assert all(step[0][1] == 0 for step in steps) and steps[-1][0][0] > 7
        register_family(line(env=None, vector=vector))
        with pytest.raises(MpdtError, match="stepped in batches only"):
            make_gym("line", "far")
