"""A family's simulator as a stable-baselines3 vector environment.

Only `pretrain.py` uses it. Rows start anew at their horizon or where their episode ends, so one run
learns the whole family:

    a batch whose rows take any goal     every episode draws a new task       (locomotion)
    a batch whose rows start anew        a row keeps its task                 (a family's `env`)
    any other                            one batch of one row per row, which keeps its task
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from mpdt.data.sim.batch import FloatArray, RestartsRows, StepResult
from mpdt.data.sim.network import behaviour_inputs
from mpdt.data.sim.simulators import make_batch
from mpdt.data.spec.family import Family, Task
from mpdt.seeding import Quality, SeedKey, Stream


class FamilyVecEnv(VecEnv):  # type: ignore[misc]  # untyped base
    """`num_rows` episodes of the tasks of one family; observations are network inputs.

    Row i starts i/num_rows of a horizon late, so that the rows do not reset all at once and
    every batch of experience covers whole episodes.

    Raises: SimulatorError for a family whose simulator is not here, or breaks the contract.
    """

    def __init__(self, family: Family, num_rows: int, seed: int, threads: int) -> None:
        self._family, self._seed = family, seed
        self._tasks = [family.tasks[row % len(family.tasks)] for row in range(num_rows)]
        self._batch = _restarting(family, self._tasks, threads)
        self._goals = np.array([task.goal for task in self._tasks])
        self._observations = np.zeros((num_rows, family.observation_size))
        self._episodes = np.zeros(num_rows, dtype=np.int64)
        self._elapsed = np.zeros(num_rows, dtype=np.int64)
        self._returns = np.zeros(num_rows)
        self._actions = np.zeros((num_rows, family.action_size), dtype=np.float32)
        for row in range(num_rows):
            self._start(row)
        size = self._inputs().shape[1]
        super().__init__(
            num_rows,
            spaces.Box(-np.inf, np.inf, (size,), np.float32),
            spaces.Box(family.action_low, family.action_high, (family.action_size,), np.float32),
        )

    @property
    def episodes(self) -> NDArray[np.int64]:
        """(B,) episodes that each row has begun; the next one's seed follows from it."""
        return self._episodes

    @episodes.setter
    def episodes(self, begun: NDArray[np.int64]) -> None:
        self._episodes = begun.copy()

    def _start(self, row: int) -> None:
        episode = int(self._episodes[row])
        key = SeedKey(self._seed, self._family.id, 0, Quality.PRETRAINING, episode, row)
        if self._batch.takes_any_goal:
            pick = key.generator(Stream.GOAL).integers(len(self._family.tasks))
            self._goals[row] = self._family.tasks[pick].goal
        self._observations[row] = self._batch.restart(row, key, self._goals[row])
        self._episodes[row] += 1
        self._elapsed[row] = 0
        self._returns[row] = 0.0

    def _inputs(self) -> NDArray[np.float32]:
        inputs = behaviour_inputs(self._family, self._observations, self._goals)
        return inputs.astype(np.float32)

    def reset(self) -> NDArray[np.float32]:
        for row in range(self.num_envs):
            self._start(row)
        self._elapsed[:] = np.arange(self.num_envs) * self._family.horizon // self.num_envs
        return self._inputs()

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Raises: ValueError for actions that are no numbers, before the simulator is blamed."""
        if not np.isfinite(actions).all():
            raise ValueError(f"actions {actions[~np.isfinite(actions).all(axis=1)][0].tolist()}")
        self._actions = np.clip(actions, self._family.action_low, self._family.action_high)

    def step_wait(self) -> tuple[Any, ...]:
        result = self._batch.step(self._actions.astype(np.float32))
        self._observations = result.observations.copy()
        self._elapsed += 1
        self._returns += result.rewards
        done = result.terminations | (self._elapsed >= self._family.horizon)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        rows = np.flatnonzero(done)
        if len(rows):
            last = self._inputs()
            for row in rows:
                infos[row] = {
                    "terminal_observation": last[row],
                    "TimeLimit.truncated": not result.terminations[row],
                    "episode": {"r": self._returns[row], "l": int(self._elapsed[row])},
                }
                self._start(int(row))
        return self._inputs(), result.rewards.astype(np.float32), done, infos

    def close(self) -> None:
        """Nothing to close: a simulator holds no process and no window."""

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        return [None] * self.num_envs  # seeded at construction, by named keys

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        raise AttributeError(f"rows have no methods of their own ({method_name})")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


def _restarting(family: Family, tasks: Sequence[Task], threads: int) -> RestartsRows:
    batch = make_batch(family, tasks)
    if not isinstance(batch, RestartsRows):
        return _RowByRow(family, tasks)
    if hasattr(batch, "use_threads"):
        batch.use_threads(threads)
    return batch


class _RowByRow:
    """A batch of its own for every row: the slow way, for those that start all rows together."""

    takes_any_goal = False

    def __init__(self, family: Family, tasks: Sequence[Task]) -> None:
        self._rows = [make_batch(family, [task]) for task in tasks]

    def restart(self, row: int, key: SeedKey, goal: FloatArray) -> FloatArray:
        observation: FloatArray = self._rows[row].reset([key], [goal])[0]
        return observation

    def step(self, actions: NDArray[np.float32]) -> StepResult:
        each = [one.step(actions[row : row + 1]) for row, one in enumerate(self._rows)]
        return StepResult(
            np.concatenate([one.observations for one in each]),
            np.concatenate([one.rewards for one in each]),
            np.concatenate([one.terminations for one in each]),
            None,
        )
