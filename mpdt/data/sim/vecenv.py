"""The batched locomotion engine as a stable-baselines3 vector environment.

Only `pretrain.py` uses it. Rows reset themselves at their horizon or on a fall, and every
episode draws a new task, so one run learns the whole family.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from mpdt.data.sim.locomotion import LocomotionBatch
from mpdt.data.sim.network import behaviour_inputs
from mpdt.data.spec.tasks import Family
from mpdt.seeding import Quality, SeedKey, Stream


class LocomotionVecEnv(VecEnv):  # type: ignore[misc]  # untyped base
    """`num_rows` episodes of random tasks of one family; observations are network inputs.

    Row i starts i/num_rows of a horizon late, so that the rows do not reset all at once and
    every batch of experience covers whole episodes.
    """

    def __init__(self, family: Family, num_rows: int, seed: int, threads: int) -> None:
        self._family, self._seed = family, seed
        tasks = [family.tasks[row % len(family.tasks)] for row in range(num_rows)]
        self._batch = LocomotionBatch(family, tasks, threads=threads)
        self._goals = np.zeros(num_rows)
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

    def _start(self, row: int) -> None:
        episode = int(self._episodes[row])
        key = SeedKey(self._seed, self._family.id, 0, Quality.PRETRAINING, episode, row)
        pick = key.generator(Stream.GOAL).integers(len(self._family.tasks))
        self._goals[row] = self._family.tasks[pick].goal[0]
        self._batch.reset_row(row, key.env_seed(), self._goals[row])
        self._episodes[row] += 1
        self._elapsed[row] = 0
        self._returns[row] = 0.0

    def _inputs(self) -> NDArray[np.float32]:
        observations = self._batch.observations()
        inputs = behaviour_inputs(self._family, observations, self._goals[:, None])
        return inputs.astype(np.float32)

    def reset(self) -> NDArray[np.float32]:
        for row in range(self.num_envs):
            self._start(row)
        self._elapsed[:] = np.arange(self.num_envs) * self._family.horizon // self.num_envs
        return self._inputs()

    def step_async(self, actions: NDArray[np.float32]) -> None:
        self._actions = np.clip(actions, self._family.action_low, self._family.action_high)

    def step_wait(self) -> tuple[Any, ...]:
        result = self._batch.step(self._actions.astype(np.float32))
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
        """Nothing to close: the engine holds no process and no window."""

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
