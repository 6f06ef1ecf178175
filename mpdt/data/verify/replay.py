"""Replay: simulate stored episodes again from seed, goal and stored actions, and compare bytes.

No policy acts, so neither weights nor BLAS matter: what is shown is that the simulator of this
machine gives the stored observations, rewards and flags for the stored actions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mpdt.data.episode import Episode
from mpdt.data.sim.batch import BatchEnv, Play, PlaysAhead
from mpdt.data.sim.simulators import make_batch
from mpdt.data.spec.tasks import Family, get_family
from mpdt.data.store.dataset import Dataset
from mpdt.errors import DataError
from mpdt.seeding import UNKNOWN_SEED_KEY, SeedKey

ROWS = 50  # episodes side by side, where the simulator steps them together


@dataclass(frozen=True)
class Replayed:
    """One episode that was simulated again.

    Args:
        place: its position in the sequence that was asked for.
        differing: names of the arrays that are not byte-equal.
        largest: largest difference of an observation.
    """

    place: int
    num_steps: int
    differing: tuple[str, ...]
    largest: float


def replay(dataset: Dataset, episodes: Sequence[Episode], horizon: int) -> Iterator[Replayed]:
    """Simulate `episodes` of `dataset` again, task by task.

    Args:
        horizon: steps after which an episode of these is truncated.
    Raises: DataError for episodes without seed; UsageError for a family or goal that cannot be
        simulated; SimulatorError.
    """
    family, seed = get_family(dataset.family), dataset.spec.get("seed")
    if not isinstance(seed, int):
        raise DataError("its spec has no seed", where=str(dataset.path))
    by_task: dict[int, list[int]] = {}
    for place, episode in enumerate(episodes):
        if episode.seed_key == UNKNOWN_SEED_KEY:
            raise DataError("episodes without a seed cannot be simulated", where=str(dataset.path))
        by_task.setdefault(episode.task, []).append(place)
    rows = 1 if family.simulator == "metaworld" else ROWS
    for task, places in sorted(by_task.items()):
        env: BatchEnv | None = None  # kept while its width fits: building one takes a while
        for first in range(0, len(places), rows):
            some = places[first : first + rows]
            if env is None or env.num_rows != len(some):
                options = dict(dataset.spec.get("env") or {})
                env = make_batch(family, [family.tasks[task]] * len(some), options)
            chosen = [episodes[place] for place in some]
            play = _play(env, chosen, [SeedKey(seed, *episode.seed_key) for episode in chosen])
            for row, place in enumerate(some):
                yield _compare(family, place, chosen[row], play, row, horizon)


@dataclass(frozen=True)
class _Played(Play):
    """A Play with successes (B, H), or None where the simulator has none."""

    successes: np.ndarray[tuple[int, int], np.dtype[np.bool_]] | None


def _play(env: BatchEnv, episodes: Sequence[Episode], keys: Sequence[SeedKey]) -> _Played:
    longest = max(episode.length for episode in episodes)
    actions = np.zeros((len(episodes), longest, env.action_size), np.float32)
    for row, episode in enumerate(episodes):
        actions[row, : episode.length] = episode.actions
    first = env.reset(keys, [episode.goal for episode in episodes])
    if isinstance(env, PlaysAhead):
        play = env.play(actions)
        return _Played(play.observations, play.rewards, play.terminations, None)
    observations, rewards, terminations, successes = [first], [], [], []
    for step in range(longest):
        result = env.step(actions[:, step])
        observations.append(result.observations)
        rewards.append(result.rewards)
        terminations.append(result.terminations)
        if result.successes is not None:
            successes.append(result.successes)
    return _Played(
        np.stack(observations, axis=1),
        np.stack(rewards, axis=1),
        np.stack(terminations, axis=1),
        np.stack(successes, axis=1) if successes else None,
    )


def _compare(
    family: Family, place: int, episode: Episode, play: _Played, row: int, horizon: int
) -> Replayed:
    length = episode.length
    observations = play.observations[row, : length + 1].astype(np.float32)
    observations[:, list(family.hidden_columns)] = 0.0
    found = {
        "observations": observations,
        "rewards": play.rewards[row, :length].astype(np.float32),
        "terminations": play.terminations[row, :length],
        "truncations": np.arange(1, length + 1) == horizon,
    }
    if episode.successes is not None and play.successes is not None:
        found["successes"] = play.successes[row, :length]
    differing = tuple(
        name for name, array in found.items() if array.tobytes() != getattr(episode, name).tobytes()
    )
    largest = float(np.abs(observations - episode.observations).max()) if differing else 0.0
    return Replayed(place, length, differing, largest)
