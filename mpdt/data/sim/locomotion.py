"""Cheetah and ant, many episodes side by side, stepped natively by `mujoco.rollout`.

Bit-identical to one `LocomotionEnv` per row (`locomotion_env.py`): the warm start is off,
the reset noise comes from the generator that gymnasium would seed, and rewards are float64.

Used by simulators.py, rungs.py, vecenv.py and vector.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from mpdt.data.sim.batch import Play, StepResult
from mpdt.data.sim.robots import FRAME_SKIP, RESET_NOISE, ROBOTS, reward_rule
from mpdt.data.spec.tasks import Family, Task
from mpdt.seeding import SeedKey, generator_of

Floats = NDArray[np.float64]

STRETCH = 20
"""Env steps per native call of `play`: fallen rows are left out of the next stretch."""


class LocomotionBatch:
    """`BatchEnv` of a locomotion family, one row per entry of `tasks`.

    Args:
        family: cheetah_dir, cheetah_vel, ant_dir or a variant of them.
        tasks: one per row; rows may differ.
        env: options of the spec's `env` block, see `robots.reward_rule`.
        threads: native threads. Results do not depend on it.
    """

    takes_any_goal = True

    def __init__(
        self,
        family: Family,
        tasks: Sequence[Task],
        env: Mapping[str, float | bool] | None = None,
        threads: int = 1,
    ) -> None:
        robot, reward = family.scene.split("/")
        self._robot = ROBOTS[robot]
        self._rule = reward_rule(robot, reward, env or {})
        self._model = self._robot.model()
        self._models = [self._model] * len(tasks)
        self._datas = [mujoco.MjData(self._model) for _ in range(threads)]
        self._pool = rollout.Rollout(nthread=threads if threads > 1 else 0)
        self._goals = np.array([task.goal[0] for task in tasks])
        self._task_goals = [np.array(task.goal) for task in tasks]
        self.num_rows = len(tasks)
        self.observation_size = family.observation_size
        self.action_size = family.action_size
        self.low = np.full(family.action_size, family.action_low)
        self.high = np.full(family.action_size, family.action_high)
        self._step_s = self._model.opt.timestep * FRAME_SKIP
        nq, nv = self._model.nq, self._model.nv
        # FULLPHYSICS layout: time, qpos, qvel (neither robot has actuator state).
        self._qpos, self._qvel = slice(1, 1 + nq), slice(1 + nq, 1 + nq + nv)
        self._state = np.zeros((self.num_rows, 1 + nq + nv))
        self._substeps = np.zeros((self.num_rows, FRAME_SKIP, 1 + nq + nv))
        self._torso = np.zeros((self.num_rows, 3))

    def draw_goals(self, keys: Sequence[SeedKey]) -> list[Floats]:
        """A locomotion goal belongs to the task: nothing is drawn."""
        return self._task_goals[: len(keys)]

    def reset(self, keys: Sequence[SeedKey], goals: Sequence[Floats]) -> Floats:
        """Start one episode per row; returns observations (B, D).

        Positions get U(-0.1, 0.1), then velocities 0.1 * N(0, 1), drawn per row from
        `key.env_seed()` in the order gymnasium's own environments use.
        """
        for row, (key, goal) in enumerate(zip(keys, goals, strict=True)):
            self.reset_row(row, key.env_seed(), goal[0])
        return self.observations()

    def reset_row(self, row: int, seed: int, goal: float) -> None:
        """Start a new episode in one row, leaving the others where they are."""
        self.start_row(row, generator_of(seed), goal)

    def restart(self, row: int, key: SeedKey, goal: Floats) -> Floats:
        """`reset_row`, as `RestartsRows` has it; its first observation (D,)."""
        self.reset_row(row, key.env_seed(), goal[0])
        state = self._state[row : row + 1]
        qpos, qvel = state[:, self._qpos], state[:, self._qvel]
        found: Floats = self._robot.observe(qpos, qvel, self._torso[row : row + 1])[0]
        return found

    def place(self, state: Floats, goals: Floats) -> None:
        """Put every row where `state` (B, nq + nv) says, with goals (B,)."""
        self._goals[:] = goals
        self._state[:, 0], self._state[:, 1:] = 0.0, state
        self._torso = self._robot.torso(self._state[:, self._qpos])

    def use_threads(self, threads: int) -> None:
        """Step with so many native threads from now on."""
        self._datas = [mujoco.MjData(self._model) for _ in range(threads)]
        self._pool = rollout.Rollout(nthread=threads if threads > 1 else 0)

    def start_row(self, row: int, generator: np.random.Generator, goal: float) -> None:
        """`reset_row` with noise from a generator that may have been drawn from before."""
        self._goals[row] = goal
        nq, nv = self._model.nq, self._model.nv
        noise = generator.uniform(-RESET_NOISE, RESET_NOISE, nq)
        self._state[row, 0] = 0.0
        self._state[row, self._qpos] = self._model.qpos0 + noise
        self._state[row, self._qvel] = RESET_NOISE * generator.standard_normal(nv)
        self._torso[row] = self._robot.torso(self._state[row, self._qpos])

    def step(self, actions: NDArray[np.float32]) -> StepResult:
        """Advance every row by one env step (five sub-steps) with actions (B, A) float32."""
        control = np.repeat(actions.astype(np.float64)[:, None, :], FRAME_SKIP, axis=1)
        self._pool.rollout(
            self._models,
            self._datas,
            self._state,
            control,
            skip_checks=True,
            nstep=FRAME_SKIP,
            state=self._substeps,
        )
        before, after = self._state, self._substeps[:, -1].copy()
        torso = self._robot.torso(self._substeps[:, -2, self._qpos])
        moved = after[:, 1:3] - before[:, 1:3]
        self._state, self._torso = after, torso
        return StepResult(
            observations=self.observations(),
            rewards=self._rule.rewards(moved / self._step_s, actions, self._goals),
            terminations=self._rule.terminations(after[:, self._qpos], after[:, self._qvel]),
            successes=None,
        )

    def play(self, actions: NDArray[np.float32]) -> Play:
        """Run whole episodes of actions (B, H, A) float32, open loop, at native speed.

        Starts from the last reset and leaves the rows there. Rows that fell are not simulated
        to the end: what follows their termination is zero.
        """
        rows, horizon = actions.shape[:2]
        played = Play(
            observations=np.zeros((rows, horizon + 1, self.observation_size)),
            rewards=np.zeros((rows, horizon)),
            terminations=np.zeros((rows, horizon), dtype=bool),
        )
        played.observations[:, 0] = self.observations()
        state, running = self._state, np.arange(rows)
        for first in range(0, horizon, STRETCH):
            some = actions[running, first : first + STRETCH]
            substeps = np.zeros((len(some), some.shape[1] * FRAME_SKIP, state.shape[1]))
            self._pool.rollout(
                self._models[: len(running)],
                self._datas,
                state,
                np.repeat(some.astype(np.float64), FRAME_SKIP, axis=1),
                skip_checks=True,
                nstep=substeps.shape[1],
                state=substeps,
            )
            substeps = substeps.reshape(*some.shape[:2], FRAME_SKIP, -1)
            after, torso = substeps[:, :, -1], self._robot.torso(substeps[:, :, -2, self._qpos])
            qpos, qvel = after[..., self._qpos], after[..., self._qvel]
            moved = np.diff(after[..., 1:3], axis=1, prepend=state[:, np.newaxis, 1:3])
            falls = self._rule.terminations(qpos, qvel)
            steps = slice(first, first + some.shape[1])
            goals = self._goals[running, np.newaxis]
            played.observations[running, first + 1 : steps.stop + 1] = self._robot.observe(
                qpos, qvel, torso
            )
            played.rewards[running, steps] = self._rule.rewards(moved / self._step_s, some, goals)
            played.terminations[running, steps] = falls
            standing = ~falls.any(axis=1)
            state, running = after[standing, -1], running[standing]
            if not len(running):
                break
        return played

    def scene(self, row: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Model and a fresh MjData in the state of a row, for a camera."""
        data = mujoco.MjData(self._model)
        data.qpos[:], data.qvel[:] = self._state[row, self._qpos], self._state[row, self._qvel]
        mujoco.mj_forward(self._model, data)
        return self._model, data

    def observations(self) -> Floats:
        """Current observations (B, D), of rows just reset as well as of rows just stepped."""
        state = self._state
        return self._robot.observe(state[:, self._qpos], state[:, self._qvel], self._torso)
