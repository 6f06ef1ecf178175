"""The locomotion tasks as ordinary gymnasium environments, one episode at a time.

The slow, obviously right twin of `locomotion.py`: MuJoCo steps one `MjData`, and the torso
position is read from the simulator instead of being rebuilt.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from mpdt.data.sim.camera import drawing, no_render_mode
from mpdt.data.sim.robots import FRAME_SKIP, RESET_NOISE, ROBOTS, reward_rule
from mpdt.data.spec.tasks import get_family
from mpdt.errors import unknown_name


class LocomotionEnv(MujocoEnv):
    """One task of cheetah_dir, cheetah_vel or ant_dir.

    Args:
        family, task: names as in the family's task list, for instance `cheetah_dir`, `forward`.
        horizon: steps after which the episode is truncated; the family's own by default.
        render_mode: as in gymnasium.
        env: reward options, see `robots.reward_rule`.

    Observation: float64 (D,), columns as `get_family(family).columns`. Action: float32 (A,) in
    [-1, 1]. `terminated` only where the ant falls, `truncated` at the horizon.
    Raises: UsageError for an unknown family or task, and for `render` without a mode; ResetNeeded
        for what comes before the first reset; SimulatorError where nothing can draw.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # gymnasium declares it per instance
        "render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"],
        "render_fps": 20,
    }

    def __init__(
        self,
        family: str,
        task: str,
        horizon: int | None = None,
        render_mode: str | None = None,
        **env: float | bool,
    ) -> None:
        row = get_family(family)
        names = {known.name: known for known in row.tasks}
        if task not in names:
            raise unknown_name(f"task of {family}", task, names)
        robot, reward = row.scene.split("/")
        self._robot, self._task_name = ROBOTS[robot], task
        self._rule = reward_rule(robot, reward, env)
        self._goal = np.array([names[task].goal[0]])
        self._horizon = row.horizon if horizon is None else horizon
        self._elapsed = -1  # not reset yet
        space = spaces.Box(-np.inf, np.inf, (row.observation_size,), np.float64)
        super().__init__(self._robot.xml, FRAME_SKIP, space, render_mode=render_mode)

    def _initialize_simulation(self) -> tuple[Any, Any]:
        model, data = super()._initialize_simulation()
        model.opt.disableflags |= self._robot.model().opt.disableflags
        return model, data

    def reset_model(self) -> NDArray[np.float64]:
        noise = self.np_random.uniform(-RESET_NOISE, RESET_NOISE, self.model.nq)
        speed = RESET_NOISE * self.np_random.standard_normal(self.model.nv)
        qpos, qvel = self.init_qpos + noise, self.init_qvel + speed
        self.set_state(qpos, qvel)  # type: ignore[no-untyped-call]
        self._elapsed = 0
        return self._observation()

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], np.float64, bool, bool, dict[str, np.float64]]:
        self._check_reset()
        action = np.asarray(action, dtype=np.float32)
        place = self.data.qpos[:2].copy()
        self.do_simulation(action.astype(np.float64), self.frame_skip)
        self._elapsed += 1
        speed = (self.data.qpos[:2] - place) / self.dt
        reward = self._rule.rewards(speed[None], action[None], self._goal)[0]
        qpos, qvel = self.data.qpos[None], self.data.qvel[None]
        terminated = bool(self._rule.terminations(qpos, qvel)[0])
        truncated = self._elapsed >= self._horizon
        return self._observation(), reward, terminated, truncated, {}

    def render(self) -> Any:
        """What `render_mode` says, as gymnasium draws it."""
        self._check_reset()
        if self.render_mode is None:
            raise no_render_mode(self._task_name)
        with drawing():
            return super().render()  # type: ignore[no-untyped-call]

    def _check_reset(self) -> None:
        if self._elapsed < 0:
            raise ResetNeeded(f"{self._task_name}: call reset() first")

    def _observation(self) -> NDArray[np.float64]:
        torso = np.array(self.data.body("torso").xpos)
        return self._robot.observe(np.array(self.data.qpos), np.array(self.data.qvel), torso)
