"""The batched engine against one gymnasium env per episode, and rewards worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from mpdt.data.sim.locomotion import LocomotionBatch
from mpdt.data.sim.locomotion_env import LocomotionEnv
from mpdt.data.sim.robots import ROBOTS, network_inputs, reward_rule
from mpdt.data.spec.tasks import get_family
from mpdt.errors import SpecError, UsageError
from mpdt.seeding import Quality, SeedKey

FAMILIES = ["cheetah_dir", "cheetah_vel", "ant_dir"]


def keys_for(family_name: str, num: int) -> list[SeedKey]:
    family = get_family(family_name)
    return [SeedKey(7, family.id, 0, Quality.RANDOM, 0, row) for row in range(num)]


@pytest.mark.parametrize("family_name", FAMILIES)
@pytest.mark.parametrize("threads", [1, 2])
def test_batched_equals_gymnasium_bit_for_bit(family_name: str, threads: int) -> None:
    """Observations, float64 rewards and falls of whole episodes, three tasks side by side."""
    family = get_family(family_name)
    tasks = [family.tasks[0], family.tasks[-1], family.tasks[1]]
    horizon = family.horizon if family_name == "cheetah_dir" else 60
    keys = keys_for(family_name, 3)
    batch = LocomotionBatch(family, tasks, threads=threads)
    envs = [LocomotionEnv(family_name, task.name) for task in tasks]
    observations = batch.reset(keys, batch.draw_goals(keys))
    for row, (env, key) in enumerate(zip(envs, keys, strict=True)):
        first, _ = env.reset(seed=key.env_seed())
        assert np.array_equal(first, observations[row])
    generator = np.random.Generator(np.random.PCG64(3))
    alive = [True] * 3
    for _ in range(horizon):
        actions = generator.uniform(-1, 1, (3, family.action_size)).astype(np.float32)
        result = batch.step(actions)
        for row, env in enumerate(envs):
            if not alive[row]:
                continue
            observation, reward, terminated, _, _ = env.step(actions[row])
            assert np.array_equal(observation, result.observations[row])
            assert reward == result.rewards[row]
            assert terminated == result.terminations[row]
            alive[row] = not terminated


def test_torso_position_lags_one_sub_step() -> None:
    """After a step the last three columns are the torso 4 sub-steps in; after a reset, now."""
    env = LocomotionEnv("cheetah_dir", "forward")
    first, _ = env.reset(seed=1)
    assert first[17] == env.data.qpos[0]
    observation, *_ = env.step(np.full(6, 0.5, dtype=np.float32))
    assert observation[17] != env.data.qpos[0]
    assert abs(observation[17] - env.data.qpos[0]) < 0.01 * 10  # one 0.01 s sub-step below 10 m/s


def test_rewards_worked_out_by_hand() -> None:
    ones = np.ones((1, 6), dtype=np.float32)
    speed = np.array([[2.0, 0.0]])
    direction = reward_rule("cheetah", "direction", {})
    assert direction.rewards(speed, ones, np.array([1.0]))[0] == pytest.approx(2.0 - 0.3)
    assert direction.rewards(speed, ones, np.array([-1.0]))[0] == pytest.approx(-2.0 - 0.3)
    velocity = reward_rule("cheetah", "velocity", {})
    assert velocity.rewards(speed, ones, np.array([0.5]))[0] == pytest.approx(-1.5 - 0.3)
    heading = reward_rule("ant", "heading", {})
    north = heading.rewards(np.array([[1.0, 3.0]]), np.ones((1, 8), np.float32), [np.pi / 2])
    assert north[0] == pytest.approx(3.0 - 0.5 * 8 + 1.0)
    cheap = reward_rule("cheetah", "direction", {"control_cost": 0.0})
    assert cheap.rewards(speed, ones, np.array([1.0]))[0] == 2.0


def test_ant_falls_outside_its_height_band_and_cheetah_never() -> None:
    qpos, qvel = np.zeros((4, 15)), np.zeros((4, 14))
    qpos[:, 2] = [0.19, 0.2, 1.0, 1.01]
    ant = reward_rule("ant", "heading", {})
    assert ant.terminations(qpos, qvel).tolist() == [True, False, False, True]
    qvel[1, 0] = np.nan
    assert ant.terminations(qpos, qvel).tolist() == [True, True, False, True]
    free = reward_rule("ant", "heading", {"terminate": False})
    assert not free.terminations(qpos, qvel).any()
    assert not reward_rule("cheetah", "direction", {}).terminations(qpos, qvel).any()


def test_reset_draws_positions_then_velocities_from_the_env_seed() -> None:
    family = get_family("cheetah_dir")
    (key,) = keys_for("cheetah_dir", 1)
    batch = LocomotionBatch(family, family.tasks[:1])
    observation = batch.reset([key], batch.draw_goals([key]))[0]
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(key.env_seed())))
    qpos = generator.uniform(-0.1, 0.1, 9)
    qvel = 0.1 * generator.standard_normal(9)
    assert np.array_equal(observation[:8], qpos[1:])
    assert np.array_equal(observation[8:17], qvel)
    assert observation[17:].tolist() == [qpos[0], 0.0, 0.7 + qpos[1]]


def test_network_inputs_hide_position() -> None:
    observation = np.arange(40.0).reshape(2, 20)
    inputs = network_inputs("cheetah", "direction", observation, np.array([1.0, -1.0]))
    assert inputs[0].tolist() == [*range(17), 1.0]
    assert inputs[1, -1] == -1.0


def test_an_ant_is_seen_from_the_side_of_its_goal() -> None:
    # Upright, yawed by 90 degrees to the left, running north at 2 m/s; the goal is north.
    observation = np.arange(27.0)[np.newaxis] + 100
    observation[0, 1:5] = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    observation[0, 13:16] = [0.0, 2.0, 0.25]
    inputs = network_inputs("ant", "heading", observation, np.array([np.pi / 2]))[0]
    assert inputs[0] == 100
    assert inputs[1:4] == pytest.approx([1, 0, 0])  # its nose points at the goal
    assert inputs[4:7] == pytest.approx([0, 1, 0])
    assert inputs[7:15].tolist() == [*range(105, 113)]
    assert inputs[15:18] == pytest.approx([2, 0, 0.25])  # towards the goal, not sideways
    assert inputs[18:].tolist() == [*range(116, 127)]


def test_turning_ant_and_goal_together_changes_no_input() -> None:
    # A rolled and pitched attitude, whose matrix has no zeros to hide a wrong sign.
    attitude = np.array([0.7, 0.4, -0.3, 0.5]) / np.linalg.norm([0.7, 0.4, -0.3, 0.5])
    observation = np.arange(27.0)[np.newaxis]
    observation[0, 1:5] = attitude
    turn = 2.0  # rad about z, applied in the world: quaternion (cos 1, 0, 0, sin 1) * attitude
    w, x, y, z = attitude
    c, s = np.cos(turn / 2), np.sin(turn / 2)
    turned = observation.copy()
    turned[0, 1:5] = [c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w]
    vx, vy = observation[0, 13:15]
    turned[0, 13:15] = [
        np.cos(turn) * vx - np.sin(turn) * vy,
        np.sin(turn) * vx + np.cos(turn) * vy,
    ]
    before = network_inputs("ant", "heading", observation, np.array([0.3]))
    after = network_inputs("ant", "heading", turned, np.array([0.3 + turn]))
    assert after == pytest.approx(before)


def test_bad_names_and_options_are_refused() -> None:
    with pytest.raises(UsageError, match=r"forwards.*did you mean 'forward'"):
        LocomotionEnv("cheetah_dir", "forwards")
    with pytest.raises(SpecError, match="contact cost"):
        reward_rule("ant", "heading", {"contact_cost": True})


def test_warm_start_is_off() -> None:
    """With it, (qpos, qvel) would not determine the next state (see docs/decisions)."""
    import mujoco

    for robot in ROBOTS.values():
        assert robot.model().opt.disableflags & mujoco.mjtDisableBit.mjDSBL_WARMSTART
