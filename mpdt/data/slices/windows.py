"""Windows: K consecutive steps of one episode, padded on the left, with a mask.

    episode of T = 5 steps, K = 3

    start 0   ->  steps 0 1 2     mask 1 1 1
    start 2   ->  steps 2 3 4     mask 1 1 1
    start 4   ->  steps - - 4     mask 0 0 1      never reaches into the next episode

Pads hold zeros everywhere. One indexed read per column, no Python loop over windows;
`tests/reference/windows.py` is the slow twin.

Shape legend: n tasks (or any leading axis), M windows of one task, K steps, D observation
columns, A action columns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mpdt.errors import ShapeError

Ids = NDArray[np.int64]
Floats = NDArray[np.float32]
Returns = Callable[[Ids, Ids], Floats]
"""(episode ids (n, M), steps (n, M, K)) -> returns-to-go (n, M, K), raw reward units."""


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
    Does not: normalise, shuffle, or read anything outside the episodes named.
    """
    length = np.asarray(source.episodes.length, np.int64)[episodes]
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
    count = np.minimum(window, length - starts)
    offset = np.arange(window) - (window - count)[..., None]
    mask = offset >= 0
    step = starts[..., None] + np.maximum(offset, 0)
    row_of_step = np.asarray(source.episodes.start, np.int64)[episodes][..., None] + step
    row_of_obs = np.asarray(source.episodes.obs_start, np.int64)[episodes][..., None] + step
    has_previous = mask & (step > 0)
    actions, observations = source.steps.actions, source.steps.observations
    n = len(episodes)
    return WindowBatch(
        observations=_masked(observations[row_of_obs], mask),
        previous_actions=_masked(actions[np.maximum(row_of_step - 1, 0)], has_previous),
        actions=_masked(actions[row_of_step], mask),
        returns_to_go=np.where(mask, returns(episodes, step), np.float32(0)),
        timesteps=np.where(mask, step, 0),
        mask=mask,
        tasks=np.arange(n) if tasks is None else tasks,
        slots=np.arange(n) if slots is None else slots,
        episodes=episodes,
        starts=starts,
    )


def reward_returns(source: WindowSource, rewards: NDArray[Any]) -> Returns:
    """Suffix sums of the rewards: what training sees. Summed in float64 from the episode's end."""

    def returns(episodes: Ids, steps: Ids) -> Floats:
        start = np.asarray(source.episodes.start, np.int64)[episodes][..., None]
        last = np.asarray(source.episodes.length, np.int64)[episodes][..., None] - 1
        first = steps.min(axis=-1, keepdims=True)
        back = np.arange(int((last - first).max()) + 1)  # 0 = the last step of the episode
        inside = last - back >= first
        tail = np.where(inside, rewards[start + np.maximum(last - back, 0)], 0.0)
        sums = np.cumsum(tail, axis=-1, dtype=np.float64)
        return np.take_along_axis(sums, last - steps, axis=-1).astype(np.float32)

    return returns


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


def _masked(values: NDArray[Any], mask: NDArray[np.bool_]) -> Floats:
    """Zeros where the mask is False; the copy also drops the memmap subclass."""
    kept = np.where(mask[..., None], values, np.float32(0))
    return np.asarray(kept, dtype=np.float32)
