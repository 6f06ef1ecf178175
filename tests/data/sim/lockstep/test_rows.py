"""Rows in lockstep against Meta-World's own step, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from mpdt.data.sim.lockstep.tasks import RULES
from mpdt.data.sim.metaworld import MAX_STEPS, MetaworldBatch, MetaworldEnv
from mpdt.data.sim.scripts import Expert
from mpdt.data.spec.tasks import get_family
from mpdt.seeding import Quality, SeedKey

MT50 = get_family("mt50")
NAMES = [task.name for task in MT50.tasks]
# What is live in Meta-World, what mixes precisions, what asks for contacts and has two objects.
SAMPLE = ["basketball", "shelf-place", "stick-push"]


def play(name, horizon, rows=3):
    """Rows of one task in lockstep: the script alone, the script mixed, uniform actions."""
    task = MT50.task(name)
    keys = [SeedKey(5, MT50.id, task.index, Quality.RANDOM, 0, row) for row in range(rows)]
    batch, expert = MetaworldBatch([task] * rows), Expert(name)
    goals = batch.draw_goals(keys)
    seen = batch.reset(keys, goals)
    generator = np.random.default_rng(7)
    mixing = np.array([0.0, 0.3, 1.0])[:rows, None]
    actions, shown, rewards, successes = [], [seen], [], []
    for step in range(horizon):
        uniform = generator.uniform(-1, 1, (rows, 4))
        chosen = np.where(generator.random((rows, 1)) < mixing, uniform, expert.act(seen))
        if step % 7 == 3:
            chosen[:, 3] = 1.0  # the end of the gripper's scale, which is held in another precision
        actions.append((chosen * (1.5 if step % 11 == 5 else 1)).astype(np.float32))
        result = batch.step(actions[-1])
        seen = result.observations
        shown.append(seen)
        rewards.append(result.rewards)
        successes.append(result.successes)
    return goals, np.array(actions), np.array(shown), np.array(rewards), np.array(successes)


def compare(name, horizon):
    """Every observation, reward and success; returns what the rewards were."""
    goals, actions, shown, rewards, successes = play(name, horizon)
    plain = MetaworldEnv(name, quick=False)
    for row, goal in enumerate(goals):
        assert plain.reset(goal).tobytes() == shown[0, row].tobytes()
        for step in range(horizon):
            seen, reward, success = plain.step(actions[step, row])
            where = f"row {row}, step {step}"
            assert seen.tobytes() == shown[step + 1, row].tobytes(), where
            assert (reward, success) == (rewards[step, row], successes[step, row]), where
    return rewards


@pytest.mark.parametrize("name", SAMPLE)
def test_rows_in_lockstep_have_the_published_bytes(name):
    assert len(np.unique(compare(name, 35))) > 10, "rewards that differ by row and step"


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_whole_episodes_of_every_task_have_the_published_bytes(name):
    compare(name, MAX_STEPS)


def test_every_task_has_rules():
    assert sorted(RULES) == sorted(NAMES)


def test_rows_of_several_tasks_share_an_env_per_task():
    """Rows of one task lie apart, and none sees another."""
    names = ["reach", "drawer-close", "reach"]
    tasks = [MT50.task(name) for name in names]
    keys = [SeedKey(5, MT50.id, task.index, Quality.RANDOM, 0, row)
            for row, task in enumerate(tasks)]  # fmt: skip
    both = MetaworldBatch(tasks)
    goals = both.draw_goals(keys)
    first = both.reset(keys, goals)
    actions = np.random.default_rng(0).uniform(-1, 1, (4, 3, 4)).astype(np.float32)
    results = [both.step(action) for action in actions]
    for row, task in enumerate(tasks):
        alone = MetaworldBatch([task])
        assert alone.reset(keys[row : row + 1], goals[row : row + 1])[0].tobytes() == \
            first[row].tobytes()  # fmt: skip
        for action, result in zip(actions, results, strict=True):
            single = alone.step(action[row : row + 1])
            assert single.observations[0].tobytes() == result.observations[row].tobytes()
            assert single.rewards[0] == result.rewards[row]
    # a camera sees the row that it is pointed at, and disturbs nobody
    hands = [both.scene(row)[1].body("hand").xpos.copy() for row in range(3)]
    np.testing.assert_array_equal(hands, results[-1].observations[:, :3])
    assert both.step(actions[0]).rewards.tolist() == both_again(tasks, keys, goals, actions)


def both_again(tasks, keys, goals, actions):
    """The rewards of one more step, nobody having looked."""
    batch = MetaworldBatch(tasks)
    batch.reset(keys, goals)
    for action in actions:
        batch.step(action)
    return batch.step(actions[0]).rewards.tolist()
