"""The acting interface: one environment, many rows, vector environments, another library's loop."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch

import mpdt
import mpdt.envs
from mpdt.errors import ShapeError, UsageError

STEPS = 7
SEEN = np.random.default_rng(0).normal(size=(STEPS, 3, 20)).astype(np.float32)
PAID = np.random.default_rng(1).normal(size=(STEPS, 3)).astype(np.float32)


@pytest.fixture
def policy(bundle):
    return mpdt.load_policy(bundle, "forward")


def alone(bundle, task, row, first, last):
    """Actions of one episode of one environment, from step `first` on."""
    policy = mpdt.load_policy(bundle, task)
    return [
        policy.act(SEEN[t, row], None if t == first else PAID[t, row]) for t in range(first, last)
    ]


def test_rows_begin_when_they_like(bundle, policy):
    """Row 1 begins anew at step 3, row 2 acts as another task: each as it would alone."""
    policy.reset(["forward", "forward", "backward"])
    found = []
    for t in range(STEPS):
        starts = np.array([t == 0, t in (0, 3), t == 0])
        found.append(policy.act_batch(SEEN[t], PAID[t], starts))
    episodes = [(0, "forward", 0, STEPS), (1, "forward", 0, 3), (1, "forward", 3, STEPS),
                (2, "backward", 0, STEPS)]  # fmt: skip
    for row, task, first, last in episodes:
        expected = alone(bundle, task, row, first, last)
        assert np.array_equal([actions[row] for actions in found[first:last]], expected)


def test_many_rows_act_the_same_on_any_number_of_threads(policy):
    """Few act on one of them; many on what there is, which is no business of their numbers."""
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            policy.reset(40)
            shown = np.tile(SEEN[:2], (1, 14, 1))[:, :40]
            found.append([policy.act_batch(shown[0]), policy.act_batch(shown[1], np.ones(40))])
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    assert np.array_equal(*found)


def test_other_returns_are_asked_of_a_task_and_of_an_episode(bundle, policy):
    assert set(policy.targets) == {"forward", "backward"}
    usual = policy.act(SEEN[0, 0])
    policy.ask(policy.targets["forward"] - 50)
    other = policy.act(SEEN[0, 0])
    assert not np.array_equal(usual, other)
    policy.ask(policy.targets["forward"], "backward")
    assert np.array_equal(policy.act(SEEN[0, 0]), other), "another task's return"
    fresh = mpdt.load_policy(bundle, "forward")
    fresh.reset(2)
    asked = [fresh.targets["forward"], policy.targets["forward"]]
    rows = fresh.act_batch(SEEN[0, :1].repeat(2, axis=0), targets=asked)
    assert np.array_equal(rows, [usual, other])
    with pytest.raises(UsageError, match="no number"):
        policy.ask(float("nan"))
    with pytest.raises(UsageError, match="unknown task"):
        policy.ask(1.0, "sideways")


def test_predict_goes_by_the_state_it_is_given(policy):
    """A state may be used twice; episode_start empties a row's."""
    first, state = policy.predict(SEEN[0])
    second, later = policy.predict(SEEN[1], state, np.zeros(3, bool))
    again, _ = policy.predict(SEEN[1], state)
    assert first.shape == (3, 6) and np.array_equal(second, again)
    begun, _ = policy.predict(SEEN[1], later, np.array([False, True, False]))
    fresh, _ = policy.predict(SEEN[1])
    assert np.array_equal(begun[1], fresh[1]) and not np.array_equal(begun[0], fresh[0])
    one, _ = policy.predict(SEEN[0, 2], deterministic=True)
    assert np.array_equal(one, first[2]) and one.shape == (6,)


def test_predict_keeps_the_return_to_go(policy):
    _, state = policy.predict(SEEN[0])
    told, _ = policy.predict(SEEN[1], state)
    policy.reset(3)
    policy.act_batch(SEEN[0])
    assert np.array_equal(policy.act_batch(SEEN[1]), told)
    policy.reset(3)
    policy.act_batch(SEEN[0])
    assert not np.array_equal(policy.act_batch(SEEN[1], PAID[1] + 9), told)


def test_evaluate_policy_of_stable_baselines3(bundle, policy):
    evaluation = pytest.importorskip("stable_baselines3.common.evaluation")
    env = gymnasium.make("mpdt/CheetahDir-v0", task="forward", horizon=4)
    mean, std = evaluation.evaluate_policy(policy, env, n_eval_episodes=2, warn=False)
    assert np.isfinite([mean, std]).all()
    returns = []
    env.reset(seed=3)
    for _ in range(2):
        (observation, _), state, over, total = env.reset(), None, False, 0.0
        while not over:
            action, state = policy.predict(observation, state)
            observation, reward, terminated, truncated, _ = env.step(action)
            over, total = terminated or truncated, total + float(reward)
        returns.append(total)
    env.reset(seed=3)
    found, _ = evaluation.evaluate_policy(
        policy, env, n_eval_episodes=2, warn=False, return_episode_rewards=True
    )
    assert found == pytest.approx(returns, abs=1e-5)


def test_a_vector_environment(bundle, policy):
    """The tutorial's loop: rows are reset by gymnasium at the step after their last."""
    tasks, horizon = ["forward", "backward"], 4
    envs = gymnasium.make_vec("mpdt/CheetahDir-v0", num_envs=2, task=tasks, horizon=horizon)
    policy.reset(tasks)
    observations, rewards = envs.reset(seed=0)[0], None
    starts, over = np.ones(2, bool), np.zeros(2, bool)
    returns = np.zeros(2)
    for _ in range(2 * (horizon + 1)):
        actions = policy.act_batch(observations, rewards, starts)
        observations, rewards, terminated, truncated, _ = envs.step(actions)
        returns += rewards
        starts, over = over, terminated | truncated
    expected = np.zeros(2)
    for row, task in enumerate(tasks):
        env, one = gymnasium.make("mpdt/CheetahDir-v0", task=task, horizon=horizon), None
        one = mpdt.load_policy(bundle, task)
        observation = env.reset(seed=row)[0]
        for _ in range(2):
            reward, ended = None, False
            while not ended:
                observation, reward, stop, cut, _ = env.step(one.act(observation, reward))
                ended, expected[row] = stop or cut, expected[row] + float(reward)
            observation = env.reset()[0]
    assert returns == pytest.approx(expected)


def test_mistakes(policy):
    with pytest.raises(ShapeError, match="observations of this family"):
        policy.act(np.zeros(19))
    for no_numbers in ("abc", np.zeros(20, complex), ["1"] * 20, [[1], [2, 3]],
                       np.array(["1"] + [2] * 19, object)):  # fmt: skip
        with pytest.raises(ShapeError, match="an observation is an array of numbers"):
            policy.act(no_numbers)
    policy.act(np.zeros(20))
    with pytest.raises(ShapeError, match="rewards are an array of numbers"):
        policy.act(np.zeros(20), "1.0")
    policy.reset()
    with pytest.raises(ShapeError, match="nobody acts"):
        policy.reset(0)
    with pytest.raises(UsageError, match="did you mean 'forward'"):
        policy.reset(["forwards"])
    policy.reset(3)
    with pytest.raises(ShapeError):
        policy.act_batch(np.zeros((2, 20)))
    with pytest.raises(ShapeError, match="one environment after many"):
        policy.act(np.zeros(20), 1.0)
