"""Pendulum-v1 of gymnasium with other masses and lengths, which the policy is not shown.

20 pairs from a named seed, m in [0.6, 1.4] kg and l in [0.6, 1.4] m, the last four for testing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.envs.classic_control.pendulum import PendulumEnv
from numpy.typing import NDArray

import mpdt

GRAVITY, TORQUE = 10.0, 2.0  # m/s^2, N m: those of Pendulum-v1
PARAMS_SEED = 20240902
NUM_TASKS, NUM_TEST = 20, 4
LOWEST, HIGHEST = 0.6, 1.4


def make(task: mpdt.Task) -> PendulumEnv:
    """The environment of a task."""
    env = PendulumEnv(g=GRAVITY)
    env.m, env.l = task.goal
    return env


def swing(observations: NDArray[np.float64], goals: NDArray[np.float64]) -> Any:
    """The expert: pump energy until the top is near, then hold; (B, 3) and (B, 2) -> (B, 1)."""
    up, right, speed = observations.T
    mass, length = goals.T
    inertia, weight = mass * length**2 / 3, mass * GRAVITY * length / 2
    energy = inertia * speed**2 / 2 + weight * (up - 1)  # 0 at rest upright
    hold = -weight * right - inertia * (25 * np.arctan2(right, up) + 8 * speed)
    pump = TORQUE * np.sign(speed + 1e-9) * np.sign(-energy)
    # Where the torque reaches to hold it, and the speed is one that it can stop.
    near = (up > 0.9) & (np.abs(hold) < 3 * TORQUE)
    return np.clip(np.where(near, hold, pump), -TORQUE, TORQUE)[:, None]


def _tasks() -> tuple[mpdt.Task, ...]:
    draws = np.random.default_rng(PARAMS_SEED).uniform(LOWEST, HIGHEST, (NUM_TASKS, 2)).round(4)
    first_test = NUM_TASKS - NUM_TEST
    return tuple(
        mpdt.Task(f"m{kg:.2f}-l{m:.2f}", i, "test" if i >= first_test else "train", (kg, m))
        for i, (kg, m) in enumerate(draws.tolist())
    )


pendulum_params = mpdt.Family(
    name="pendulum_params",
    tasks=_tasks(),
    columns=("cos_angle [1]", "sin_angle [1]", "speed [rad/s]"),
    action_size=1,
    action_low=-TORQUE,
    action_high=TORQUE,
    horizon=200,
    step_s=0.05,
    return_target=-100.0,
    return_scale=500.0,
    env=make,
    scripts={"swing": swing},
    ends_early=False,
    about="A pendulum is to be swung up, its mass and length hidden",
    steps_per_s=30_000.0,
)
