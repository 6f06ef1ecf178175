from __future__ import annotations

import hashlib
import subprocess
import sys
import warnings

import numpy as np
import pytest

from mpdt.data.sim.actors import Rows
from mpdt.data.sim.metaworld import GOAL_COLUMNS, MAX_STEPS, MetaworldBatch, MetaworldEnv
from mpdt.data.sim.scripted import ScriptedPolicy
from mpdt.data.sim.simulators import make_batch
from mpdt.data.spec.tasks import get_family
from mpdt.errors import ShapeError, SpecError, UsageError
from mpdt.seeding import SeedKey, Stream

ML10 = get_family("ml10")


def key(task: str, row: int = 0) -> SeedKey:
    return SeedKey(11, ML10.id, ML10.task(task).index, 2, 0, row)


def tasks(*names: str):
    return [ML10.task(name) for name in names]


def scripted_bytes(env, names, keys, num_steps):
    """SHA-256 over everything an episode of the script returns."""
    digest = hashlib.sha256()
    goals = env.draw_goals(keys)
    observations = env.reset(keys, goals)
    policy = ScriptedPolicy(names, 0.3)
    policy.begin(Rows(keys, goals, num_steps))
    for goal in goals:
        digest.update(goal.tobytes())
    for step in range(num_steps):
        digest.update(observations.tobytes())
        result = env.step(policy.act(step, observations).astype(np.float32))
        observations = result.observations
        digest.update(result.rewards.tobytes() + result.successes.tobytes())
    return digest.hexdigest()


@pytest.fixture(scope="module")
def push():
    return MetaworldEnv("push")


@pytest.fixture(scope="module")
def reach():
    return MetaworldBatch(tasks("reach"))


def test_two_processes_and_a_used_env_give_the_same_bytes():
    names = ("push", "drawer-close")
    keys = [key(name) for name in names]
    env = make_batch(ML10, tasks(*names))
    first = scripted_bytes(env, names, keys, 25)
    assert scripted_bytes(env, names, keys, 25) == first
    other = [key(name, row=1) for name in names]
    assert scripted_bytes(env, names, other, 25) != first
    assert scripted_bytes(env, names, keys, 25) == first
    code = (
        "import runpy, sys; module = runpy.run_path(sys.argv[1]);"
        "names = ('push', 'drawer-close'); keys = [module['key'](n) for n in names];"
        "env = module['make_batch'](module['ML10'], module['tasks'](*names));"
        "print(module['scripted_bytes'](env, names, keys, 25))"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, __file__], capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == first


def test_rows_do_not_see_each_other():
    keys = [key("reach", row) for row in range(2)]
    both = MetaworldBatch(tasks("reach", "reach"))
    single = MetaworldBatch(tasks("reach"))
    goals = both.draw_goals(keys)
    start = both.reset(keys, goals)
    np.testing.assert_array_equal(start[1:], single.reset(keys[1:], goals[1:]))
    actions = np.array([[1, 0, 0, 0], [0, -1, 1, 1]], dtype=np.float32)
    wide, narrow = both.step(actions), single.step(actions[1:])
    np.testing.assert_array_equal(wide.observations[1:], narrow.observations)
    np.testing.assert_array_equal(wide.rewards[1:], narrow.rewards)


def test_goal_depends_on_the_key_alone(reach, push):
    (goal,) = reach.draw_goals([key("reach")])
    reach.draw_goals([key("reach", 5)])
    reach.reset([key("reach")], [goal])
    reach.step(np.ones((1, 4), dtype=np.float32))
    (again,) = reach.draw_goals([key("reach")])
    (fresh,) = MetaworldBatch(tasks("reach")).draw_goals([key("reach")])
    np.testing.assert_array_equal(again, goal)
    np.testing.assert_array_equal(fresh, goal)
    others = [reach.draw_goals([key("reach", row)])[0].tobytes() for row in range(1, 6)]
    assert len({goal.tobytes(), *others}) == 6


def test_goal_is_the_envs_own_seeded_draw_until_it_accepts(push):
    """Push refuses vectors whose object and goal are closer than 0.15 m in the plane."""
    redrawn = 0
    for row in range(40):
        seed = key("push", row).env_seed(Stream.GOAL)
        goal = push.draw(seed)
        space = push._env._random_reset_space
        generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
        draws = [generator.uniform(space.low, space.high)]
        while np.linalg.norm(draws[-1][:2] - draws[-1][3:5]) < 0.15:
            draws.append(generator.uniform(space.low, space.high))
        np.testing.assert_array_equal(goal, draws[-1])
        redrawn += len(draws) > 1
    assert redrawn > 0, "no key of this test exercises a refusal"


def slow_draw(env: MetaworldEnv, seed: int) -> np.ndarray:
    """The slow twin: the published reset with the hand moved home, one model reset."""
    inner = env._env
    inner._freeze_rand_vec, inner.seeded_rand_vec = False, True
    inner.seed(seed)
    inner.reset_model()
    inner._freeze_rand_vec, inner.seeded_rand_vec = True, False
    return np.array(inner._last_rand_vec)


@pytest.mark.parametrize("name", ["push", "peg-insert-side", "lever-pull", "sweep-into"])
def test_drawing_without_moving_the_hand_changes_no_goal(name):
    env = MetaworldEnv(name)
    for seed in (3, 2**62 + 1):
        np.testing.assert_array_equal(env.draw(seed), slow_draw(env, seed))


@pytest.mark.slow
@pytest.mark.parametrize("name", [task.name for task in get_family("mt50").tasks])
def test_all_tasks_draw_reset_and_step_like_the_plain_env(name):
    fast, plain = MetaworldEnv(name), MetaworldEnv(name, quick=False)
    policy = ScriptedPolicy([name], 0.1)
    for row in range(2):
        seed = key("reach", row).env_seed(Stream.GOAL)
        goal = fast.draw(seed)
        np.testing.assert_array_equal(goal, slow_draw(plain, seed))
        policy.begin(Rows([key("reach", row)], [goal], MAX_STEPS))
        observation = fast.reset(goal)
        np.testing.assert_array_equal(observation, plain.reset(goal))
        for step in range(250):
            action = policy.act(step, observation[None])[0].astype(np.float32)
            observation, *rest = fast.step(action)
            expected, *expected_rest = plain.step(action)
            np.testing.assert_array_equal(observation, expected)
            assert rest == expected_rest


@pytest.mark.parametrize("name", ["push", "sweep"])
def test_contact_arrays_give_the_same_bytes_as_the_contact_loop(name):
    fast, slow = MetaworldEnv(name), MetaworldEnv(name, quick=False)
    asked = []
    contacts = fast._env.touching_object
    fast._env.touching_object = lambda geom: asked.append(contacts(geom)) or asked[-1]
    goal = fast.draw(1)
    observation = fast.reset(goal)
    slow.reset(goal)
    policy = ScriptedPolicy([name], 0.0)
    policy.begin(Rows([key(name)], [goal], 120))
    for step in range(120):
        action = policy.act(step, observation[None])[0].astype(np.float32)
        observation, *rest = fast.step(action)
        expected, *expected_rest = slow.step(action)
        np.testing.assert_array_equal(observation, expected)
        assert rest == expected_rest
    assert set(asked) == {True, False}, "the script must grasp within the test"


def test_reset_is_the_published_one_with_the_goal_shown(push):
    goal = push.draw(9)
    observation = push.reset(goal)
    from metaworld.env_dict import ENV_CLS_MAP

    published = ENV_CLS_MAP["push-v3"]()
    published._set_task_called, published._freeze_rand_vec = True, True
    published._last_rand_vec = goal.copy()
    expected, _ = published.reset()
    np.testing.assert_array_equal(observation[:36], expected[:36])
    assert expected[GOAL_COLUMNS].tolist() == [0.0, 0.0, 0.0]
    # Push puts its goal on the table: x and y are the vector's.
    np.testing.assert_array_equal(observation[36:38], goal[3:5])
    for value in (0.5, -1.0):
        action = np.array([value, 0.3, -0.7, value], dtype=np.float32)
        seen, reward, success = push.step(action)
        raw, raw_reward, _, _, info = published.step(action)
        np.testing.assert_array_equal(seen[:36], raw[:36])
        assert (reward, success) == (float(raw_reward), bool(info["success"]))


def test_script_with_the_visible_goal_reaches_it():
    """The script moves up to 0.01 m per step and goals are at most 0.4 m away."""
    env = MetaworldEnv("reach")
    policy = ScriptedPolicy(["reach"], 0.0)
    for row in range(3):
        goal = env.draw(row)
        observation = env.reset(goal)
        np.testing.assert_array_equal(observation[GOAL_COLUMNS], goal[3:])
        policy.begin(Rows([key("reach", row)], [goal], 100))
        successes, rewards = [], []
        for step in range(100):
            action = policy.act(step, observation[None])[0].astype(np.float32)
            observation, reward, success = env.step(action)
            successes.append(success)
            rewards.append(reward)
        assert not successes[0] and successes[-1]
        assert rewards[-1] == 10.0


def test_refused_or_foreign_vectors_raise_instead_of_looping(push):
    close = np.array([0.1, 0.7, 0.02, 0.1, 0.8, 0.015])  # 0.10 m apart, 0.15 wanted
    with pytest.raises(UsageError, match="push: the env refuses this reset vector"):
        push.reset(close)
    with pytest.raises(UsageError, match="outside the task's reset space"):
        push.reset(np.array([5.0, 0.7, 0.02, 0.1, 0.8, 0.015]))
    with pytest.raises(UsageError, match="outside the task's reset space"):
        push.reset(np.zeros(3))
    push.reset(push.draw(0))  # still usable


def test_steps_end_at_500_and_before_a_reset():
    env = MetaworldEnv("drawer-open")
    goal = env.draw(0)
    action = np.zeros(4, dtype=np.float32)
    with pytest.raises(UsageError, match="episode is over"):
        env.step(action)
    env.reset(goal)
    for _ in range(500):
        env.step(action)
    with pytest.raises(UsageError, match="a Meta-World episode is over"):
        env.step(action)


def test_shapes_and_dtypes_are_checked(reach):
    reach.reset([key("reach")], reach.draw_goals([key("reach")]))
    with pytest.raises(ShapeError, match=r"expected \(1, 4\) float32, found \(1, 4\) float64"):
        reach.step(np.zeros((1, 4)))
    with pytest.raises(ShapeError, match="wrong number of keys; expected 1 rows, found 2"):
        reach.draw_goals([key("reach")] * 2)
    result = reach.step(np.zeros((1, 4), dtype=np.float32))
    assert result.observations.shape == (1, 39) and result.observations.dtype == np.float64
    assert result.rewards.dtype == np.float64 and not result.terminations.any()
    assert result.successes.dtype == np.bool_


def test_make_batch_refuses_options_and_emptiness():
    with pytest.raises(SpecError, match=r"ml10\.env: unknown simulator option 'control_cost'"):
        make_batch(ML10, tasks("reach"), {"control_cost": 0.1})
    with pytest.raises(SpecError, match="at least one task"):
        make_batch(ML10, [])


def test_global_state_is_left_alone():
    before, filters = np.random.get_state()[1].copy(), list(warnings.filters)  # noqa: NPY002
    env = MetaworldBatch(tasks("reach"))
    env.reset([key("reach")], env.draw_goals([key("reach")]))
    env.step(np.ones((1, 4), dtype=np.float32))
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002
    assert warnings.filters == filters


def test_unknown_task_names_the_nearest():
    with pytest.raises(UsageError, match=r"unknown Meta-World task 'puch' \(did you mean 'push'"):
        MetaworldEnv("puch")
