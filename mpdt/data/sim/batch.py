"""BatchEnv: what every simulator looks like, and `roll_out`, the one loop that steps it.

Used by play.py (collecting), rungs.py (judging snapshots), stored.py (replay and film) and
`mpdt/train/evaluate` (judging what was trained).

    env   = make_batch(family, tasks, options)     one task per row, rows may differ
    goals = env.draw_goals(keys)                   what the episode is about
    obs   = env.reset(keys, goals)                 (B, D), the goal is visible
    step  = env.step(actions)                      (B, A) float32, exactly what gets stored

A row is one episode at a time and never looks at its neighbours' tasks, goals or keys.
Nothing resets by itself: a finished row goes on being simulated until the caller stops.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from mpdt.seeding import SeedKey

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class StepResult:
    """What one step of all rows returned.

    Shapes: observations (B, D) float64, in the family's column units; rewards (B,) float64,
    the task's own reward; terminations (B,) bool, the task's own rule ended the episode (the
    horizon is the caller's); successes (B,) bool, or None where the simulator has none.
    """

    observations: FloatArray
    rewards: FloatArray
    terminations: BoolArray
    successes: BoolArray | None


class BatchEnv(Protocol):
    """B episodes of one family side by side. `low` and `high` are (A,) float64 bounds."""

    @property
    def observation_size(self) -> int: ...

    @property
    def action_size(self) -> int: ...

    @property
    def num_rows(self) -> int: ...

    @property
    def low(self) -> FloatArray: ...

    @property
    def high(self) -> FloatArray: ...

    def draw_goals(self, keys: Sequence[SeedKey]) -> list[FloatArray]:
        """Goal vector (G,) float64 per row.

        Locomotion answers with the task's fixed goal, Meta-World draws from stream GOAL of
        the row's key. A pure function of (task, key): call it in any order, any number of
        times.
        """
        ...

    def reset(self, keys: Sequence[SeedKey], goals: Sequence[FloatArray]) -> FloatArray:
        """First observations (B, D). A pure function of (tasks, keys, goals).

        The env's own noise comes from `key.env_seed()`; a simulator without reset noise
        ignores it.
        """
        ...

    def step(self, actions: npt.NDArray[np.float32]) -> StepResult:
        """One env step of all rows. `actions` is (B, A) float32: the numbers that are stored."""
        ...


@dataclass(frozen=True)
class Play:
    """Whole episodes of ready-made actions; row b is valid up to its first termination.

    Shapes: observations (B, H + 1, D) float64 with the first one of the reset, rewards (B, H)
    float64, terminations (B, H) bool, successes (B, H) bool or None where the simulator has none.
    """

    observations: FloatArray
    rewards: FloatArray
    terminations: BoolArray
    successes: BoolArray | None = None


@runtime_checkable
class PlaysAhead(Protocol):
    """A BatchEnv that can run an episode natively when all its actions are known before."""

    def play(self, actions: npt.NDArray[np.float32]) -> Play:
        """Run actions (B, H, A) from the last reset. The same bytes as H calls of `step`."""
        ...


@runtime_checkable
class RestartsRows(Protocol):
    """A BatchEnv whose rows can begin an episode each by itself, for whoever trains behaviour.

    takes_any_goal: a row may be given the goal of any task of the family.
    """

    @property
    def takes_any_goal(self) -> bool: ...

    def restart(self, row: int, key: SeedKey, goal: FloatArray) -> FloatArray:
        """Begin an episode in one row, as `reset` would; its first observation (D,)."""
        ...

    def step(self, actions: npt.NDArray[np.float32]) -> StepResult: ...


@runtime_checkable
class HasScene(Protocol):
    """A BatchEnv that a camera can look at."""

    def scene(self, row: int) -> tuple[Any, Any]:
        """MuJoCo's (MjModel, MjData) of a row as it stands now; look, do not touch the data."""
        ...


Choose = Callable[[int, FloatArray, FloatArray | None, BoolArray], npt.NDArray[np.float32]]
"""(step, observations (B, D), rewards of the step before or None, running (B,)) -> (B, A)."""


@dataclass(frozen=True)
class Rolled:
    """One step of `roll_out`.

    Args:
        running: (B,) rows that had not ended before this step.
    """

    step: int
    actions: npt.NDArray[np.float32]
    result: StepResult
    running: BoolArray


def roll_out(env: BatchEnv, first: FloatArray, choose: Choose, horizon: int) -> Iterator[Rolled]:
    """Step all rows until each has ended, `horizon` steps at most.

    Rows that have ended are stepped along with the others, so that the batch keeps its width.

    Args:
        first: observations (B, D) that the reset gave.
        choose: who acts; what it answers is given to the simulator as it is.
    """
    observations, rewards = first, None
    running = np.ones(len(first), np.bool_)
    for step in range(horizon):
        actions = choose(step, observations, rewards, running)
        result = env.step(actions)
        yield Rolled(step, actions, result, running)
        observations, rewards = result.observations, result.rewards
        running = running & ~result.terminations
        if not running.any():
            return
