"""One own episode on an unseen task: the simulator, whoever acts, and what is remembered.

Keys are of a quality of their own (TRIAL), so no trial begins or has its goal where an evaluation
does. Where goals are numbered (MT10), trials take the training ones.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mpdt.data.episode import UNKNOWN_PROGRESS, Episode
from mpdt.data.sim.batch import BatchEnv, roll_out
from mpdt.data.sim.play import Record
from mpdt.data.spec.tasks import Family
from mpdt.errors import TrainingError
from mpdt.seeding import Quality, SeedKey

Floats = NDArray[np.float32]
Act = Callable[[int, Floats, float | None, Record], NDArray[np.floating]]
"""(step, observation (D,) without its goal, reward of the step before, the episode so far)
-> action (A,)."""


def trial_key(seed: int, family: Family, task: int, number: int) -> SeedKey:
    """Of trial `number` (from 0) of a task."""
    return SeedKey(seed, family.id, task, Quality.TRIAL, 0, number)


def live(
    env: BatchEnv, family: Family, key: SeedKey, goal_key: SeedKey, horizon: int, act: Act,
    policy: bytes,
) -> Episode:  # fmt: skip
    """Run the episode of `key` in a simulator of one row.

    Args:
        policy: hash of who acts, kept with the episode.
    Raises: TrainingError for an action that is no number.
    """
    goals = env.draw_goals([goal_key])
    first = env.reset([key], goals)
    record = Record.of(first, env.action_size, horizon, family.hidden_columns)

    def choose(
        step: int, observations: NDArray[np.float64], rewards: NDArray[np.float64] | None,
        running: NDArray[np.bool_],
    ) -> Floats:  # fmt: skip
        shown = observations[0].astype(np.float32)
        shown[list(family.hidden_columns)] = 0
        paid = None if rewards is None else float(np.float32(rewards[0]))
        action = np.clip(act(step, shown, paid, record), env.low, env.high).astype(np.float32)
        if not np.isfinite(action).all():
            raise TrainingError("an action in a trial is not a number", where=family.name,
                                found=f"step {step}", hint="lower --adapt.trials.lr"
                                )  # fmt: skip
        return action[None]

    for rolled in roll_out(env, first, choose, horizon):
        record.add(rolled)
    return record.episode(0, key, goals[0], policy, Quality.POLICY, UNKNOWN_PROGRESS)


def first_success(episode: Episode) -> int | None:
    """Step of it; None where there is none."""
    if episode.successes is None or not episode.successes.any():
        return None
    return int(episode.successes.argmax())
