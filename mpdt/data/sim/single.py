"""EnvBatch: gymnasium environments side by side, one per row, as a family's `env` makes them.

    reset   env.reset(seed=key.env_seed())       step   env.step(the stored action)

Nothing an environment answers is believed: shapes, types and numbers are looked at in every step,
and whatever it raises names family, task and step. A row that has ended is not stepped again: it
goes on showing its last observation, with reward 0.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import TimeLimit
from numpy.typing import NDArray

from mpdt.data.sim.batch import FloatArray, StepResult
from mpdt.data.spec.family import Family, Task, resolve
from mpdt.errors import MpdtError, SimulatorError, UsageError, quoted
from mpdt.seeding import SeedKey

_NUMBERS = (float, int, np.floating, np.integer)


class EnvBatch:
    """`BatchEnv` of a family with `env`, one environment per entry of `tasks`.

    Raises: SimulatorError for an environment that breaks the contract.
    """

    takes_any_goal = False

    def __init__(
        self, family: Family, tasks: Sequence[Task], options: Mapping[str, float | bool]
    ) -> None:
        self._family, self._tasks = family, tuple(tasks)
        self.observation_size, self.action_size = family.observation_size, family.action_size
        self.num_rows = len(self._tasks)
        self.low = np.full(family.action_size, family.action_low)
        self.high = np.full(family.action_size, family.action_high)
        self._envs = [make_env(family, task, options) for task in self._tasks]
        self._action_type = self._envs[0].action_space.dtype or np.dtype(np.float32)
        self._steps = [env.step for env in self._envs]
        self._has_success, self._type = family.has_success, np.dtype(np.float64)
        self._clear()

    def _clear(self) -> None:
        self._observations = np.zeros((self.num_rows, self.observation_size))
        self._running = list(range(self.num_rows))
        self._cut: dict[int, int] = {}  # rows that their own time limit ended, and after how much
        self._num_steps = -1

    def draw_goals(self, keys: Sequence[SeedKey]) -> list[FloatArray]:
        """A task is its goal: nothing is drawn."""
        return [np.array(task.goal, np.float64) for task in self._tasks[: len(keys)]]

    def reset(self, keys: Sequence[SeedKey], goals: Sequence[FloatArray]) -> FloatArray:
        """First observations (B, D). Raises: UsageError for a goal that is not the task's."""
        check_goals(self._family, self._tasks, goals)
        self._clear()
        first: list[NDArray[Any]] = []
        for row, (env, key) in enumerate(zip(self._envs, keys, strict=True)):
            with told(self._family, self._tasks[row], "reset"):
                observation, _ = env.reset(seed=key.env_seed())
            if not isinstance(observation, np.ndarray) or observation.dtype.kind not in "fiu":
                raise self._broken(row, "the observation is no array of numbers",
                                   type(observation).__name__)  # fmt: skip
            first.append(observation)
        self._type = first[0].dtype
        self._observations[:] = self._stacked(first)
        self._num_steps = 0
        self._check_finite(np.zeros(self.num_rows))
        return self._observations

    def restart(self, row: int, key: SeedKey, goal: FloatArray) -> FloatArray:
        """Begin an episode in one row, as `RestartsRows` has it; its first observation (D,)."""
        check_goals(self._family, self._tasks[row : row + 1], [goal])
        with told(self._family, self._tasks[row], "reset"):
            first, _ = self._envs[row].reset(seed=key.env_seed())
        if np.shape(first) != (self.observation_size,) or not np.isfinite(first).all():
            raise self._broken(row, "a first observation that is none", str(first)[:120])
        self._type = first.dtype
        self._observations = self._observations.copy()
        self._observations[row] = first
        self._running = sorted({*self._running, row})
        self._num_steps = max(self._num_steps, 0)
        found: FloatArray = self._observations[row]
        return found

    def step(self, actions: NDArray[np.float32]) -> StepResult:
        """One step of every row that has not ended."""
        if self._num_steps < 0:
            raise UsageError("reset comes before the first step", where=self._family.name)
        for row, steps in self._cut.items():
            raise self._broken(
                row,
                "the environment has a time limit of its own",
                f"{steps} steps",
                hint="lower the horizon to it, or make it without TimeLimit",
            )
        # Of a set for adaptation they may be outside: the simulator clips them.
        given = np.clip(actions, self.low, self.high).astype(self._action_type)
        running, seen, paid = self._running, list[Any](), list[Any]()
        ended, successes = list[int](), np.zeros(self.num_rows, np.bool_)
        self._num_steps += 1
        row = running[0] if running else -1
        try:
            # All that is done per row stands here: it costs as much as a small environment.
            with redirect_stdout(sys.stderr):
                for row, action in zip(running, given[running], strict=True):
                    observation, reward, terminated, truncated, info = self._steps[row](action)
                    seen.append(observation)
                    paid.append(reward)
                    if terminated:
                        ended.append(row)
                    elif truncated:
                        self._cut[row] = self._num_steps
                    if self._has_success:
                        successes[row] = info["success"]
        except MpdtError:
            raise
        except (Exception, SystemExit) as error:
            raise raised(self._family, self._tasks[row], f"step {self._num_steps - 1}", error
                         ) from error  # fmt: skip
        rewards, over = np.zeros(self.num_rows), np.ones(self.num_rows, np.bool_)
        if running:
            self._observations = self._observations.copy()
            self._observations[running] = self._stacked(seen)
            rewards[running] = self._numbers(paid)
            over[running] = False
            over[ended] = True
            self._check_finite(rewards)
        if ended:
            check_end(self._family, self._tasks[ended[0]], self._num_steps - 1)
            self._running = [row for row in running if row not in ended]
        return StepResult(
            self._observations, rewards, over, successes if self._has_success else None
        )

    def _stacked(self, seen: list[Any]) -> FloatArray:
        """Observations of the running rows. Raises: SimulatorError for another shape or type."""
        size = self.observation_size
        try:
            flat = np.concatenate(seen)
            # Lengths too: one that is short and one that is long fill the same room.
            good = flat.shape == (len(seen) * size,) and all(len(one) == size for one in seen)
        except (ValueError, TypeError):
            good = False
        if good and flat.dtype == self._type:
            return flat.reshape(-1, size)
        for row, observation in zip(self._running, seen, strict=True):
            if np.shape(observation) != (size,):
                raise self._broken(row, "an observation of another shape",
                                   str(np.shape(observation)), f"({size},)")  # fmt: skip
            found = np.asarray(observation).dtype
            if found != self._type:
                raise self._broken(row, "an observation of another type than at reset",
                                   str(found), str(self._type))  # fmt: skip
        return np.array(seen, np.float64)

    def _numbers(self, paid: list[Any]) -> FloatArray:
        """Rewards of the running rows. Raises: SimulatorError for what is no number."""
        try:
            found = np.array(paid)
        except (ValueError, TypeError):
            found = np.zeros(0)
        if found.shape == (len(paid),) and found.dtype.kind in "fiu":
            return found.astype(np.float64)
        for row, reward in zip(self._running, paid, strict=True):
            if not isinstance(reward, _NUMBERS):
                raise self._broken(row, "the reward is no number", type(reward).__name__)
        raise self._broken(self._running[0], "the rewards are no numbers", str(paid)[:80])

    def scene(self, row: int) -> tuple[Any, Any]:
        """MuJoCo's own (MjModel, MjData) of a row. Raises: SimulatorError where there is none."""
        inner: Any = self._envs[row].unwrapped
        if not (hasattr(inner, "model") and hasattr(inner, "data")):
            raise SimulatorError("no picture: this environment has no MuJoCo scene",
                                 where=self._family.name)  # fmt: skip
        return inner.model, inner.data

    def _check_finite(self, rewards: FloatArray) -> None:
        if np.isfinite(self._observations).all() and np.isfinite(rewards).all():
            return
        good = np.isfinite(self._observations).all(axis=1) & np.isfinite(rewards)
        row = int(np.flatnonzero(~good)[0])
        what = "reward" if np.isfinite(self._observations[row]).all() else "observation"
        shown = rewards[row] if what == "reward" else self._observations[row]
        raise self._broken(row, f"a number of the {what} is not finite", str(shown)[:120])

    def _broken(
        self, row: int, what: str, found: str, expected: str = "", hint: str = ""
    ) -> SimulatorError:
        at = "reset" if self._num_steps < 1 else f"step {self._num_steps - 1}"
        return broken(self._family, self._tasks[row], at, what, found, expected, hint)


def broken(
    family: Family, task: Task, at: str, what: str, found: str, expected: str = "", hint: str = ""
) -> SimulatorError:
    """The error for an environment that breaks the contract; `at` is `reset` or `step 57`."""
    where = f"{family.module or family.name}, task {task.name}, {at}"
    hint = hint or f"mpdt-data check-family {quoted(family.name)} looks at all of it"
    return SimulatorError(what, where=where, expected=expected, found=found, hint=hint)


def raised(family: Family, task: Task, at: str, error: BaseException) -> SimulatorError:
    """The error for an environment that raised one."""
    text = " ".join(str(error).split())[:200]
    return broken(family, task, at, "the environment raised", f"{type(error).__name__}: {text}")


@contextmanager
def told(family: Family, task: Task, at: str) -> Iterator[None]:
    """Raises: SimulatorError in place of whatever is raised inside."""
    try:
        with redirect_stdout(sys.stderr):  # what it prints is no part of our answer
            yield
    except MpdtError:
        raise
    except (Exception, SystemExit) as error:
        raise raised(family, task, at, error) from error


def make_env(
    family: Family, task: Task, options: Mapping[str, Any]
) -> gymnasium.Env[NDArray[Any], Any]:
    """The environment of a task. Raises: SimulatorError for one with other spaces."""
    with told(family, task, "making it"):
        env = resolve(family.env)(task, **options)
    if not isinstance(env, gymnasium.Env):
        raise broken(family, task, "making it", "no gymnasium environment", type(env).__name__)
    observations, actions = (getattr(env, f"{name}_space", None)
                             for name in ("observation", "action"))  # fmt: skip
    check_spaces(family, task, observations, actions)
    return env


def check_spaces(
    family: Family, task: Task, observations: spaces.Space[Any] | None,
    actions: spaces.Space[Any] | None,
) -> None:  # fmt: skip
    """Raises: SimulatorError unless both are Boxes as the family says."""
    for name, space, size in (("observation", observations, family.observation_size),
                              ("action", actions, family.action_size)):  # fmt: skip
        if not isinstance(space, spaces.Box) or space.shape != (size,):
            raise broken(family, task, "making it", f"another {name} space than the family's",
                         str(space)[:120], f"a Box of shape ({size},)")  # fmt: skip
    assert isinstance(actions, spaces.Box)
    low, high = np.float32(family.action_low), np.float32(family.action_high)
    if not ((actions.low == low).all() and (actions.high == high).all()):
        raise broken(family, task, "making it", "other action bounds than the family's",
                     f"{actions.low.tolist()} to {actions.high.tolist()}"[:120],
                     f"{family.action_low} to {family.action_high} in every component",
                     "one pair of bounds holds for all: scale the others inside")  # fmt: skip


def check_end(family: Family, task: Task, step: int) -> None:
    """Raises: SimulatorError where an episode ends before its horizon and none is to."""
    if not family.ends_early:
        raise broken(family, task, f"step {step}", "the episode ends here", "terminated",
                     "none before the horizon: ends_early is false")  # fmt: skip


def check_goals(family: Family, tasks: Sequence[Task], goals: Sequence[FloatArray]) -> None:
    """Raises: UsageError for a goal that is not the task's."""
    for task, goal in zip(tasks, goals, strict=True):
        if not np.array_equal(goal, np.array(task.goal, np.float64)):
            raise UsageError("another goal than the task's", where=f"{family.name}, {task.name}",
                             expected=str(task.goal), found=str(goal.tolist()),
                             hint="the file is of another version of the family")  # fmt: skip


class _Hiding(gymnasium.ObservationWrapper[NDArray[Any], Any, NDArray[Any]]):
    """Shows what a file stores: hidden columns are 0."""

    def __init__(self, env: gymnasium.Env[NDArray[Any], Any], family: Family) -> None:
        super().__init__(env)
        self._hidden = list(family.hidden_columns)

    def observation(self, observation: NDArray[Any]) -> NDArray[Any]:
        shown = observation.copy()
        shown[self._hidden] = 0
        return shown


def single_env(
    family: Family, task: Task, horizon: int | None = None, **options: Any
) -> gymnasium.Env[NDArray[Any], Any]:
    """The gymnasium environment of a family with `env`, with the family's horizon.

    Raises: UsageError for a family that is stepped in batches only; SimulatorError.
    """
    if family.env is None:
        raise UsageError("this family is stepped in batches only", where=family.name,
                         hint="give it `single`, a function that makes one")  # fmt: skip
    env = _Hiding(make_env(family, task, options), family)
    return TimeLimit(env, family.horizon if horizon is None else horizon)
