"""Point robot: a point in the plane that is to reach a goal it is not shown.

position + action -> position, reward minus the distance to the goal, 20 steps, no end. 50 goals
uniform in [-1, 1]^2 from a named seed, the last five for testing.

Source of the rules: Meta-DT (Wang et al. 2024), environments/point_robot.py; its goals are others.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

import mpdt

STEP = 0.1  # the longest move along each axis
GOALS_SEED = 20240901
NUM_TASKS, NUM_TEST = 50, 5


class PointRobot(gymnasium.Env[NDArray[np.float64], NDArray[np.float32]]):
    """One goal; the robot starts at (0, 0)."""

    def __init__(self, goal: tuple[float, ...]) -> None:
        self._goal = np.array(goal)
        self._position = np.zeros(2)
        self.observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float64)
        self.action_space = spaces.Box(-STEP, STEP, (2,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        super().reset(seed=seed)
        self._position = np.zeros(2)
        return self._position.copy(), {}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], float, bool, bool, dict[str, Any]]:
        self._position = self._position + action.astype(np.float64)
        reward = -float(np.hypot(*(self._position - self._goal)))
        return self._position.copy(), reward, False, False, {}


def make(task: mpdt.Task) -> PointRobot:
    """The environment of a task."""
    return PointRobot(task.goal)


def straight(observations: NDArray[np.float64], goals: NDArray[np.float64]) -> Any:
    """The expert: straight to the goal, (B, 2) and (B, 2) -> (B, 2)."""
    way = goals - observations
    # The longer side decides, so that the direction stays what it is.
    return way / np.maximum(np.abs(way).max(axis=1, keepdims=True) / STEP, 1.0)


def _tasks() -> tuple[mpdt.Task, ...]:
    goals = np.random.default_rng(GOALS_SEED).uniform(-1.0, 1.0, (NUM_TASKS, 2)).round(6)
    first_test = NUM_TASKS - NUM_TEST
    return tuple(
        mpdt.Task(f"goal-{i:02d}", i, "test" if i >= first_test else "train", (float(x), float(y)))
        for i, (x, y) in enumerate(goals)
    )


point_robot = mpdt.Family(
    name="point_robot",
    tasks=_tasks(),
    columns=("x [m]", "y [m]"),
    action_size=2,
    action_low=-STEP,
    action_high=STEP,
    horizon=20,
    step_s=1.0,
    return_target=0.0,
    return_scale=10.0,
    env=make,
    scripts={"straight": straight},
    ends_early=False,
    about="A point in the plane is to reach a goal it is not shown",
    steps_per_s=50_000.0,
)
