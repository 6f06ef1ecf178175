"""Play stored actions: episodes of a file simulated again from their seed, goal and actions.

No policy acts, so neither weights nor BLAS matter. Used by verify/replay.py, which compares whole
episodes, and by card/film.py, which looks at every step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from mpdt.data.episode import Episode
from mpdt.data.sim.batch import BatchEnv, BoolArray, FloatArray, Play, PlaysAhead, Rolled, roll_out
from mpdt.seeding import SeedKey


def play_stored(env: BatchEnv, episodes: Sequence[Episode], keys: Sequence[SeedKey]) -> Play:
    """One episode per row of `env`, natively where it can.

    Args:
        keys: of the episodes; their noise at the reset comes from there.

    Returns: row b is valid up to the length of its episode; what follows is of no episode.
    """
    actions = _actions_of(env, episodes)
    first = env.reset(keys, [episode.goal for episode in episodes])
    if isinstance(env, PlaysAhead):
        return env.play(actions)
    rows, horizon = actions.shape[:2]
    observations = np.zeros((rows, horizon + 1, env.observation_size))
    rewards, terminations = np.zeros((rows, horizon)), np.zeros((rows, horizon), np.bool_)
    successes: BoolArray | None = None
    observations[:, 0] = first
    for rolled in _roll(env, first, actions):
        step, result = rolled.step, rolled.result
        observations[:, step + 1], rewards[:, step] = result.observations, result.rewards
        terminations[:, step] = result.terminations
        if result.successes is not None:
            successes = np.zeros_like(terminations) if successes is None else successes
            successes[:, step] = result.successes
    return Play(observations, rewards, terminations, successes)


def watch_stored(env: BatchEnv, episode: Episode, key: SeedKey) -> Iterator[FloatArray]:
    """The observations (D,) of one episode; whoever iterates sees `env` as it was at each."""
    first = env.reset([key], [episode.goal])
    yield first[0]
    for rolled in _roll(env, first, _actions_of(env, [episode])):
        yield rolled.result.observations[0]


def _actions_of(env: BatchEnv, episodes: Sequence[Episode]) -> npt.NDArray[np.float32]:
    """(B, H, A), zero behind the end of the shorter episodes."""
    longest = max(episode.length for episode in episodes)
    actions = np.zeros((len(episodes), longest, env.action_size), np.float32)
    for row, episode in enumerate(episodes):
        actions[row, : episode.length] = episode.actions
    return actions


def _roll(env: BatchEnv, first: FloatArray, actions: npt.NDArray[np.float32]) -> Iterator[Rolled]:
    return roll_out(env, first, lambda step, *_: actions[:, step], actions.shape[1])
