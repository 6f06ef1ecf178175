"""The same tasks as ordinary gymnasium environments.

    env = make("ml10", "reach")                      entry point "mpdt.data.sim.gym:make"
    observation, info = env.reset(seed=7)
    observation, info = env.reset(options={"goal": [...]})      a goal out of a dataset

Replaying an episode of a file: reset with its goal (Meta-World) or its env seed (locomotion),
then step its stored float32 actions; observations are float64 here and float32 in the file.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.error import ResetNeeded

from mpdt.data.sim.camera import SIDE, Camera, Pixels, check_render_mode, drawing, no_render_mode
from mpdt.data.sim.metaworld import (
    GOAL_COLUMNS,
    MAX_STEPS,
    OBSERVATION_SIZE,
    MetaworldEnv,
    quiet,
)
from mpdt.data.sim.scripts import ACTION_SIZE
from mpdt.data.sim.single import single_env
from mpdt.data.spec.family import resolve, view_of
from mpdt.data.spec.tasks import get_family
from mpdt.errors import UsageError

FloatArray = npt.NDArray[np.float64]


def make(family: str, task: str, **kwargs: Any) -> gymnasium.Env[FloatArray, Any]:
    """The gymnasium env of one task, as its family defines horizon and goal visibility.

    Args:
        family, task: names in the registry, for example "ml10" and "reach".
        kwargs: what the env class takes beyond that: `horizon`, `goal_hidden` (Meta-World),
            `render_mode` and simulator options (locomotion). JSON values only, so that the
            call can be written into a file.

    Raises: UsageError for an unknown family or task.
    """
    row = get_family(family)
    known = row.task(task)
    if row.single is None:
        return single_env(row, known, **kwargs)
    single: gymnasium.Env[FloatArray, Any] = resolve(row.single)(family, task, **kwargs)
    return single


def metaworld_task(family: str, task: str, **kwargs: Any) -> MetaworldTask:
    """A task of Meta-World as its family defines it, unless `kwargs` say otherwise."""
    row = get_family(family)
    defaults: dict[str, Any] = {"horizon": row.horizon, "goal_hidden": row.goal_hidden}
    return MetaworldTask(task, **(defaults | kwargs))


class MetaworldTask(gymnasium.Env[FloatArray, npt.NDArray[np.float32]]):
    """One Meta-World task with a goal per episode.

    Observation: float64 (39,), metres; columns 36:39 are the goal, 0 if `goal_hidden`.
    Action: float32 (4,) in [-1, 1]. Reward 0 to 10. Never terminated; truncated at `horizon`.
    Every info has the same keys: `success` of the step, False at reset, and `goal`, a copy of the
    reset vector. `render_mode="rgb_array"`: `render()` gives (480, 480, 3) uint8.

    `reset(seed=n)` draws the goal that the env accepts under seed n, so the goal of a dataset
    episode also comes from `seed=key.env_seed(Stream.GOAL)`; without a seed the next one of
    `np_random` is used. `reset(options={"goal": vector})` takes the vector itself.

    Raises: UsageError for an unknown task or render mode, a horizon outside 1..500, a vector the
        task does not accept, or a step past the horizon; ResetNeeded before the first reset;
        SimulatorError where nothing can draw.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # as the base declares it
        "render_modes": ["rgb_array"],
        "render_fps": 80,
    }

    def __init__(
        self,
        task: str,
        horizon: int = MAX_STEPS,
        goal_hidden: bool = True,
        render_mode: str | None = None,
    ) -> None:
        if not 1 <= horizon <= MAX_STEPS:
            raise UsageError(
                "horizon out of range", where=task, expected=f"1 to {MAX_STEPS}", found=str(horizon)
            )
        check_render_mode(render_mode, task)
        self._env = MetaworldEnv(task)
        self._horizon, self._goal_hidden, self.render_mode = horizon, goal_hidden, render_mode
        self._num_steps, self._goal = 0, np.zeros(0)  # an empty goal: not reset yet
        self._camera: Camera | None = None
        with quiet():
            self.observation_space = spaces.Box(-np.inf, np.inf, (OBSERVATION_SIZE,), np.float64)
            self.action_space = spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        super().reset(seed=seed)
        if options and "goal" in options:
            goal = np.asarray(options["goal"], dtype=np.float64)
        else:
            # The seed must fit an int64, as those of SeedKey.env_seed do.
            goal = self._env.draw(int(self.np_random.integers(2**63)) if seed is None else seed)
        observation = self._shown(self._env.reset(goal))
        self._num_steps, self._goal = 0, goal
        return observation, self._info(success=False)

    def step(
        self, action: npt.NDArray[np.float32]
    ) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        self._check_reset()
        if self._num_steps >= self._horizon:
            raise UsageError("the episode is over", where=self._env.task_name, hint="call reset()")
        observation, reward, success = self._env.step(np.asarray(action, dtype=np.float32))
        self._num_steps += 1
        truncated = self._num_steps == self._horizon
        return self._shown(observation), reward, False, truncated, self._info(success)

    def render(self) -> Pixels:
        """The scene as it stands, (480, 480, 3)."""
        self._check_reset()
        if self.render_mode is None:
            raise no_render_mode(self._env.task_name)
        with drawing():
            if self._camera is None:
                self._camera = Camera(self._env.scene[0], view_of(get_family("mt50")), SIDE, SIDE)
            return self._camera.frame(self._env.scene[1])

    def close(self) -> None:
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _check_reset(self) -> None:
        if not self._goal.size:
            raise ResetNeeded(f"{self._env.task_name}: call reset() first")

    def _info(self, success: bool) -> dict[str, Any]:
        return {"goal": self._goal.copy(), "success": success}

    def _shown(self, observation: FloatArray) -> FloatArray:
        if self._goal_hidden:
            observation[GOAL_COLUMNS] = 0.0
        return observation
