"""Windows: K consecutive steps of one episode, padded on the left, with a mask.

    episode of T = 5 steps, K = 3

    start 0   ->  steps 0 1 2     mask 1 1 1
    start 2   ->  steps 2 3 4     mask 1 1 1
    start 4   ->  steps - - 4     mask 0 0 1      never reaches into the next episode

Pads hold zeros everywhere. One copy per window and column, no Python loop over windows;
`tests/data/slices/test_slow_twins.py` holds the slow twin.

Shape legend: n tasks (or any leading axis), M windows of one task, K steps, D observation
columns, A action columns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mpdt.data.slices.spans import Spans, plain
from mpdt.errors import ShapeError

Ids = NDArray[np.int64]
Floats = NDArray[np.float32]
Returns = Callable[[Ids, Ids], Floats]
"""(episode ids (n, M), ascending steps (n, M, K)) -> returns-to-go (n, M, K), reward units; an
array of its own, in which pads are overwritten."""

KEPT_STEPS = 1 << 26
"""Of larger files `RewardReturns` keeps sums alone; 256 MB of returns."""
SUM_EVERY = 16
"""Steps between two sums that it keeps then."""


class StepColumns(Protocol):
    """Flat step arrays of a file or of a TTA set (which has no rewards)."""

    @property
    def observations(self) -> NDArray[Any]: ...
    @property
    def actions(self) -> NDArray[Any]: ...


class EpisodeColumns(Protocol):
    """Where each episode lies in the step arrays."""

    @property
    def start(self) -> NDArray[Any]: ...
    @property
    def obs_start(self) -> NDArray[Any]: ...
    @property
    def length(self) -> NDArray[Any]: ...


class WindowSource(Protocol):
    """What windows are cut from: an open dataset, or one of its TTA sets."""

    @property
    def steps(self) -> StepColumns: ...
    @property
    def episodes(self) -> EpisodeColumns: ...


@dataclass(frozen=True)
class WindowBatch:
    """M windows of each of n tasks. All arrays are fresh copies, never views of a file."""

    observations: Floats  # (n, M, K, D) family units
    previous_actions: Floats  # (n, M, K, A) zeros before an episode's first step
    actions: Floats  # (n, M, K, A) the targets
    returns_to_go: Floats  # (n, M, K) reward units, to the true end of the episode
    timesteps: Ids  # (n, M, K) step within the episode, 0 on pads
    mask: NDArray[np.bool_]  # (n, M, K) False on pads
    tasks: Ids  # (n,) row of /tasks
    slots: Ids  # (n,) position in the sampler's list of tasks: the prompt's index
    episodes: Ids  # (n, M) episode ids
    starts: Ids  # (n, M) first step of each window


class WindowCutter:
    """Cuts windows of K steps from one source; what every batch needs is looked up once."""

    def __init__(self, source: WindowSource, window: int) -> None:
        self._length = np.asarray(source.episodes.length, np.int64)
        self._start = np.asarray(source.episodes.start, np.int64)
        self._obs_start = np.asarray(source.episodes.obs_start, np.int64)
        self._observations = Spans(source.steps.observations, window)
        self._actions = Spans(source.steps.actions, window)
        self._places = np.arange(window)

    def cut(
        self,
        episodes: Ids,
        starts: Ids,
        returns: Returns,
        tasks: Ids | None = None,
        slots: Ids | None = None,
    ) -> WindowBatch:
        """As `gather_windows`."""
        length = self._length.take(episodes)
        if episodes.shape != starts.shape or episodes.ndim != 2:
            raise ShapeError(
                "episodes and starts of windows disagree",
                expected="two arrays of one shape (n, M)",
                found=f"{episodes.shape} and {starts.shape}",
            )
        outside = (starts < 0) | (starts >= length)
        if outside.any():
            row = tuple(np.argwhere(outside)[0])
            raise ShapeError(
                "a window starts outside its episode",
                where=f"episode {int(episodes[row])}",
                expected=f"a start in [0, {int(length[row])})",
                found=str(int(starts[row])),
            )
        window, n = len(self._places), len(episodes)
        pads = starts + (window - length)
        np.maximum(pads, 0, out=pads)
        first = starts - pads  # the K rows that end where the window ends
        row_of_step = self._start.take(episodes) + first
        observations = self._observations.at(self._obs_start.take(episodes) + first)
        actions = self._actions.at(row_of_step)
        previous = np.empty_like(actions)
        previous[..., 1:, :] = actions[..., :-1, :]
        previous[..., 0, :] = self._actions.row(np.maximum(row_of_step - 1, 0))
        begins = np.flatnonzero(starts == 0)
        previous.reshape(-1, window, actions.shape[-1])[begins, pads.reshape(-1)[begins]] = 0
        step = first[..., None] + self._places
        mask = np.ones(step.shape, np.bool_)
        # Few windows reach beyond their episode: what pads need is done for those alone.
        short = np.flatnonzero(pads)
        inside = self._places >= pads.reshape(-1, 1)[short]
        mask.reshape(-1, window)[short] = inside
        holes = (short[:, None] * window + self._places)[~inside]
        step.reshape(-1)[holes] = starts.reshape(-1)[holes // window]
        returns_to_go = np.asarray(returns(episodes, step), np.float32)
        for values in (observations, actions, previous):
            values.reshape(-1, values.shape[-1])[holes] = 0
        returns_to_go.reshape(-1)[holes] = 0
        step.reshape(-1)[holes] = 0
        return WindowBatch(
            observations=np.asarray(observations, np.float32),
            previous_actions=np.asarray(previous, np.float32),
            actions=np.asarray(actions, np.float32),
            returns_to_go=returns_to_go,
            timesteps=step,
            mask=mask,
            tasks=np.arange(n) if tasks is None else tasks,
            slots=np.arange(n) if slots is None else slots,
            episodes=episodes,
            starts=starts,
        )


def gather_windows(
    source: WindowSource,
    episodes: Ids,
    starts: Ids,
    window: int,
    returns: Returns,
    tasks: Ids | None = None,
    slots: Ids | None = None,
) -> WindowBatch:
    """Cut one window per entry of `episodes` (n, M), beginning at step `starts` (n, M).

    Raises: ShapeError if the two disagree in shape or a start lies outside its episode.
    Does not: normalise, shuffle, or read anything but rows before a short window, which become
        pads, and the episodes named.
    """
    return WindowCutter(source, window).cut(episodes, starts, returns, tasks, slots)


class RewardReturns:
    """`Returns` of the data: suffix sums of the rewards, what training sees.

    Summed one after another from the episode's end, in float64, once an episode has been seen.
    Of files of up to `KEPT_STEPS` steps the returns themselves are kept, 4 bytes a step; of larger
    ones the sums at every S-th step, so that a window adds up at most S + K rewards and not the
    whole rest of its episode: the same additions in the same order, hence the same bits.

        back     T-1  ...  2S  ...  S  ...  1   0      steps from the episode's end
        kept                x       x                  sums of all that lies behind, float64
    """

    def __init__(self, source: WindowSource, rewards: NDArray[Any]) -> None:
        self._start = np.asarray(source.episodes.start, np.int64)
        self._length = np.asarray(source.episodes.length, np.int64)
        self._rewards = plain(rewards)
        self._seen = np.zeros(len(self._length), np.bool_)
        self._keeps_all = len(rewards) <= KEPT_STEPS
        places = self._length if self._keeps_all else -(-self._length // SUM_EVERY)
        self._place = np.cumsum(places) - places
        self._kept = np.zeros(int(places.sum()), np.float32 if self._keeps_all else np.float64)

    def __call__(self, episodes: Ids, steps: Ids) -> Floats:
        if not self._seen[episodes].all():
            for episode in np.unique(episodes[~self._seen[episodes]]):
                self._sum_up(int(episode))
        if self._keeps_all:
            return np.asarray(self._kept.take(self._place[episodes][..., None] + steps), np.float32)
        start, last = self._start[episodes], self._length[episodes] - 1
        kept = (last - steps[..., -1]) // SUM_EVERY
        back = np.arange(SUM_EVERY + steps.shape[-1]) + (kept * SUM_EVERY)[..., None]
        inside = last[..., None] - back
        # Rewards before the window are added last and never looked at.
        tail = self._rewards.take(start[..., None] + np.maximum(inside, 0))
        sums = np.empty((*tail.shape[:-1], tail.shape[-1] + 1))
        sums[..., 0], sums[..., 1:] = self._kept[self._place[episodes] + kept], tail
        np.cumsum(sums, axis=-1, out=sums)
        at = last[..., None] - steps - (kept * SUM_EVERY)[..., None] + 1
        return np.take_along_axis(sums, at, axis=-1).astype(np.float32)

    def _sum_up(self, episode: int) -> None:
        start, length = int(self._start[episode]), int(self._length[episode])
        backwards = self._rewards[start : start + length][::-1]
        sums = np.cumsum(backwards, dtype=np.float64)
        at = int(self._place[episode])
        if self._keeps_all:
            self._kept[at : at + length] = sums[::-1]
        else:
            # Nothing lies behind the last step; -0.0 is what adds nothing to either zero.
            self._kept[at] = -0.0
            rest = slice(at + 1, at + -(-length // SUM_EVERY))
            self._kept[rest] = sums[SUM_EVERY - 1 : -1 : SUM_EVERY]
        self._seen[episode] = True


def constant_returns(preset: NDArray[Any]) -> Returns:
    """The user's wish (E,), the same at every step: reads no reward of the unseen task."""

    def returns(episodes: Ids, steps: Ids) -> Floats:
        wished = np.asarray(preset, np.float32)[episodes]
        return np.broadcast_to(wished[..., None], steps.shape).astype(np.float32)

    return returns


def decreasing_returns(
    source: WindowSource, preset: NDArray[Any], rewards: NDArray[Any]
) -> Returns:
    """The wish (E,) less what the simulator has paid so far, as in closed-loop evaluation."""

    def returns(episodes: Ids, steps: Ids) -> Floats:
        start = np.asarray(source.episodes.start, np.int64)[episodes][..., None]
        before = np.arange(int(steps.max()))
        inside = before < steps.max(axis=-1, keepdims=True)
        paid = np.where(inside, rewards[start + np.where(inside, before, 0)], 0.0)
        sums = np.cumsum(paid, axis=-1, dtype=np.float64)
        sums = np.concatenate([np.zeros((*sums.shape[:-1], 1)), sums], axis=-1)
        wished = np.asarray(preset, np.float64)[episodes][..., None]
        return (wished - np.take_along_axis(sums, steps, axis=-1)).astype(np.float32)

    return returns


def cover(lengths: NDArray[Any], episodes: Ids, window: int) -> tuple[Ids, Ids]:
    """Windows that hold every step of `episodes` exactly once: starts 0, K, 2K, ...

    Returns: (episode ids (W,), starts (W,)), in the order of `episodes`.
    """
    counts = -(-np.asarray(lengths, np.int64)[episodes] // window)
    ids = np.repeat(np.asarray(episodes, np.int64), counts)
    first = np.repeat(np.cumsum(counts) - counts, counts)
    return ids, (np.arange(len(ids)) - first) * window
