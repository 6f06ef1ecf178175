"""VectorBatch: a gymnasium VectorEnv, one row per task, as a family's `vector` makes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from mpdt.data.sim.batch import FloatArray, StepResult
from mpdt.data.sim.single import broken, check_end, check_goals, check_spaces, told
from mpdt.data.spec.family import Family, Task, resolve
from mpdt.errors import SimulatorError
from mpdt.seeding import SeedKey


class VectorBatch:
    """`BatchEnv` of a family with `vector`.

    A row that has ended may start anew by itself: whoever steps does not look at it again.

    Raises: SimulatorError for an environment that breaks the contract.
    """

    def __init__(
        self, family: Family, tasks: Sequence[Task], options: Mapping[str, float | bool]
    ) -> None:
        self._family, self._tasks = family, tuple(tasks)
        self.observation_size, self.action_size = family.observation_size, family.action_size
        self.num_rows = len(self._tasks)
        self.low = np.full(family.action_size, family.action_low)
        self.high = np.full(family.action_size, family.action_high)
        self._num_steps = 0
        self._ended = np.zeros(self.num_rows, np.bool_)
        self._cut = np.zeros(self.num_rows, np.bool_)
        with told(family, self._tasks[0], "making it"):
            env = resolve(family.vector)(list(self._tasks), **options)
        if not isinstance(env, VectorEnv):
            raise self._broken(0, "no gymnasium VectorEnv", type(env).__name__)
        if env.num_envs != self.num_rows:
            raise self._broken(0, "another number of rows", str(env.num_envs), str(self.num_rows))
        if env.metadata.get("autoreset_mode") is AutoresetMode.SAME_STEP:
            # The last observation of an episode would be the first of the next.
            raise self._broken(0, "rows start anew in the step that ends them", "SAME_STEP",
                               "AutoresetMode.NEXT_STEP or DISABLED")  # fmt: skip
        check_spaces(family, self._tasks[0], env.single_observation_space, env.single_action_space)
        self._env: VectorEnv[Any, Any, Any] = env
        self._action_type = env.single_action_space.dtype

    def draw_goals(self, keys: Sequence[SeedKey]) -> list[FloatArray]:
        """A task is its goal: nothing is drawn."""
        return [np.array(task.goal, np.float64) for task in self._tasks[: len(keys)]]

    def reset(self, keys: Sequence[SeedKey], goals: Sequence[FloatArray]) -> FloatArray:
        """First observations (B, D). Raises: UsageError for a goal that is not the task's."""
        check_goals(self._family, self._tasks, goals)
        self._num_steps = 0
        self._ended[:] = self._cut[:] = False
        seeds: Any = [key.env_seed() for key in keys]  # gymnasium takes more than it declares
        with told(self._family, self._tasks[0], "reset"):
            observations, _ = self._env.reset(seed=seeds)
        return self._checked("observation", observations, (self.num_rows, self.observation_size))

    def step(self, actions: NDArray[np.float32]) -> StepResult:
        """One step of all rows."""
        if (still := self._cut & ~self._ended).any():
            raise self._broken(int(still.argmax()), "the environment has a time limit of its own",
                               f"{self._num_steps} steps",
                               hint="lower the horizon to it, or make it without")  # fmt: skip
        given = np.clip(actions, self.low, self.high).astype(self._action_type)
        self._num_steps += 1
        with told(self._family, self._tasks[0], f"step {self._num_steps - 1}"):
            observations, rewards, terminations, truncations, info = self._env.step(given)
            successes = info["success"] if self._family.has_success else None
        rows = (self.num_rows,)
        ended = self._checked("termination", terminations, rows).astype(np.bool_)
        cut = self._checked("truncation", truncations, rows).astype(np.bool_)
        if (first := ended & ~self._ended).any():
            check_end(self._family, self._tasks[int(first.argmax())], self._num_steps - 1)
        result = StepResult(
            self._checked("observation", observations, (*rows, self.observation_size)),
            self._checked("reward", rewards, rows),
            ended,
            None if successes is None else self._checked("success", successes, rows).astype(bool),
        )
        self._cut = cut & ~ended & ~self._ended
        self._ended = self._ended | ended
        return result

    def _checked(self, what: str, array: Any, shape: tuple[int, ...]) -> FloatArray:
        """A copy, so that what the environment does to its own arrays is not seen."""
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiub":
            raise self._broken(0, f"{what}s are no array of numbers", type(array).__name__)
        if array.shape != shape:
            raise self._broken(0, f"{what}s of another shape", str(array.shape), str(shape))
        found = array.astype(np.float64)
        good = np.isfinite(found.reshape(self.num_rows, -1)).all(axis=1) | self._ended
        if not good.all():
            row = int((~good).argmax())
            raise self._broken(row, f"a number of the {what} is not finite", str(found[row])[:120])
        return found

    def _broken(
        self, row: int, what: str, found: str, expected: str = "", hint: str = ""
    ) -> SimulatorError:
        at = "reset" if self._num_steps < 1 else f"step {self._num_steps - 1}"
        return broken(self._family, self._tasks[row], at, what, found, expected, hint)
