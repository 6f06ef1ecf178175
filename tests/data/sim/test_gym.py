from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from mpdt.data.sim.gym import MetaworldTask, make
from mpdt.data.sim.simulators import make_batch
from mpdt.data.spec.tasks import get_family
from mpdt.errors import UsageError
from mpdt.seeding import SeedKey, Stream

ML10 = get_family("ml10")
KEY = SeedKey(3, ML10.id, 0, 2, 0, 0)


@pytest.fixture(scope="module")
def reach():
    return make("ml10", "reach", horizon=4)


def test_agrees_with_the_batch_byte_by_byte(reach):
    batch = make_batch(ML10, [ML10.task("reach")])
    goals = batch.draw_goals([KEY])
    expected = batch.reset([KEY], goals)[0]
    observation, info = reach.reset(seed=KEY.env_seed(Stream.GOAL))
    np.testing.assert_array_equal(info["goal"], goals[0])
    np.testing.assert_array_equal(observation[:36], expected[:36])
    replayed, _ = reach.reset(options={"goal": goals[0].tolist()})
    np.testing.assert_array_equal(replayed, observation)
    for step in range(4):
        action = np.array([0.1 * step, 1, -0.3, 0], dtype=np.float32)
        observation, reward, terminated, truncated, info = reach.step(action)
        result = batch.step(action[None])
        np.testing.assert_array_equal(observation[:36], result.observations[0, :36])
        assert reward == result.rewards[0] and info["success"] == result.successes[0]
        assert (terminated, truncated) == (False, step == 3)
    with pytest.raises(UsageError, match="the episode is over"):
        reach.step(action)


def test_goal_is_hidden_in_ml_and_shown_in_mt(reach):
    hidden, info = reach.reset(seed=1)
    assert hidden[36:].tolist() == [0.0, 0.0, 0.0]
    shown, _ = make("mt10", "reach").reset(seed=1)
    np.testing.assert_array_equal(shown[36:], info["goal"][3:])
    np.testing.assert_array_equal(shown[:36], hidden[:36])
    stepped = make("ml10", "reach", goal_hidden=False)
    stepped.reset(seed=1)
    assert stepped.step(np.zeros(4, dtype=np.float32))[0][36:].tolist() == shown[36:].tolist()


def test_unseeded_resets_draw_further_goals_reproducibly(reach):
    def goals():
        return [reach.reset(seed=5)[1]["goal"], *(reach.reset()[1]["goal"] for _ in range(2))]

    first, again = goals(), goals()
    np.testing.assert_array_equal(first, again)
    assert len({goal.tobytes() for goal in first}) == 3


@pytest.mark.filterwarnings("ignore::UserWarning")  # infinite bounds, no render modes
def test_gymnasiums_own_checker_and_a_text_entry_point(reach):
    check_env(reach, skip_render_check=True)
    spec = gymnasium.envs.registration.EnvSpec(
        "mpdt-reach-v0",
        entry_point="mpdt.data.sim.gym:make",
        kwargs={"family": "ml10", "task": "reach", "horizon": 3},
        disable_env_checker=True,
    )
    env = gymnasium.make(spec)
    assert isinstance(env.unwrapped, MetaworldTask)
    assert env.reset(seed=0)[0].shape == (39,)
    assert gymnasium.envs.registration.EnvSpec.from_json(spec.to_json()).kwargs == spec.kwargs


def test_locomotion_families_are_made_too():
    observation, _ = make("cheetah_dir", "forward").reset(seed=0)
    assert observation.shape == (20,)


def test_mistakes_are_named():
    with pytest.raises(UsageError, match="horizon out of range; expected 1 to 500, found 501"):
        make("ml10", "reach", horizon=501)
    with pytest.raises(UsageError, match=r"unknown task 'reech' \(did you mean 'reach'"):
        make("ml10", "reech")
    with pytest.raises(UsageError, match="unknown family 'ml11'"):
        make("ml11", "reach")
