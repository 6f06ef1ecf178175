"""Training batches as a pure function of (seed, step): resuming needs no sampler state.

    generator = SeedSequence([seed, step])
    1. tasks      which of them take part in this update (all, by default)
    2. episode    chance proportional to its length          per task, in ascending order
    3. start      uniform in -start_bias ... T-1, cut at 0

Windows begin uniformly in 0 ... T-1, so the last ones are short and padded on the left
(mxu34/prompt-dt@5f665e5, pdt_main.py, get_batch). `start_bias` shows the beginning of
episodes more often than that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from mpdt.data.slices.windows import (
    EpisodeColumns,
    RewardReturns,
    StepColumns,
    WindowBatch,
    WindowCutter,
)
from mpdt.errors import DataError, UsageError
from mpdt.seeding import generator_at


class SamplerSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How windows are drawn for one update."""

    window: int = 20
    """K, steps of context."""
    per_task: int = 16
    """M, windows of each task in one update."""
    tasks_per_update: int = 0
    """How many tasks take part in one update; 0 = all of them."""
    order: Literal["random", "sequential"] = "random"
    """Which tasks take part when not all do: drawn anew, or one after another."""
    start_bias: int = 0
    """Extra virtual starts before an episode's first step, cut at 0."""

    def __post_init__(self) -> None:
        for name, least in (("window", 1), ("per_task", 1), ("tasks_per_update", 0),
                            ("start_bias", 0)):  # fmt: skip
            if getattr(self, name) < least:
                raise UsageError(
                    "setting out of range",
                    where=f"sampler.{name}",
                    expected=f"at least {least}",
                    found=str(getattr(self, name)),
                )


class RewardColumns(StepColumns, Protocol):
    @property
    def rewards(self) -> NDArray[Any]: ...


class TrainingSource(Protocol):
    """An open dataset, as far as the sampler looks at it."""

    @property
    def steps(self) -> RewardColumns: ...
    @property
    def episodes(self) -> EpisodeColumns: ...


class WindowSampler:
    """Draws windows of several tasks from one open dataset.

    Args:
        dataset: open dataset; read through its memory maps, nothing is kept.
        episode_ids: absolute episode ids per task row; what may be drawn.
        tasks: rows of /tasks, in the order of their prompts (the batch's `slots`).
        seed: root seed; equal seeds give equal batches.
    Raises: DataError if a task has no episode.
    """

    def __init__(
        self,
        dataset: TrainingSource,
        episode_ids: Mapping[int, NDArray[np.int64]],
        tasks: Sequence[int],
        window: int,
        per_task: int,
        seed: int,
        start_bias: int = 0,
        tasks_per_update: int = 0,
        order: Literal["random", "sequential"] = "random",
    ) -> None:
        self.tasks = np.asarray(tasks, np.int64)
        self.window, self.per_task, self.seed = window, per_task, seed
        self._start_bias, self.order = start_bias, order
        self.num_slots = min(tasks_per_update or len(tasks), len(tasks))
        self._dataset = dataset
        self._cutter = WindowCutter(dataset, window)
        self._returns = RewardReturns(dataset, dataset.steps.rewards)
        self._ids = [np.asarray(episode_ids.get(task, ()), np.int64) for task in tasks]
        for task, ids in zip(tasks, self._ids, strict=True):
            if not len(ids):
                raise DataError(
                    "no episode to train on",
                    where=f"task row {task}",
                    hint="mpdt-data show FILE --tasks lists what each task has",
                )
        self._table = _Table(self._ids, np.asarray(dataset.episodes.length, np.int64), start_bias)

    def __reduce__(self) -> tuple[Any, ...]:
        """For a worker: it maps the file for itself."""
        ids = dict(zip(self.tasks.tolist(), self._ids, strict=True))
        return WindowSampler, (
            self._dataset, ids, self.tasks.tolist(), self.window, self.per_task, self.seed,
            self._start_bias, self.num_slots, self.order,
        )  # fmt: skip

    @property
    def start_bias(self) -> int:
        """To be read alone: another one is another sampler, whose table was made for it."""
        return self._start_bias

    def __getitem__(self, step: int) -> WindowBatch:
        """`batch`, under the name by which torch's DataLoader asks for it."""
        return self.batch(step)

    def batch(self, step: int) -> WindowBatch:
        """The windows of update `step`: (n, M, K, ...), the same on every call."""
        generator = generator_at(self.seed, step)
        slots = self._slots(step, generator)
        drawn = self._table.draw_at_once(generator, slots, self.per_task)
        if drawn is None:
            generator = generator_at(self.seed, step)
            slots = self._slots(step, generator)
            drawn = self._table.draw(generator, slots, self.per_task)
        episodes, starts = drawn
        return self._cutter.cut(episodes, starts, self._returns, self.tasks[slots], slots)

    def _slots(self, step: int, generator: np.random.Generator) -> NDArray[np.int64]:
        """Ascending positions of the tasks of this update."""
        total, n = len(self.tasks), self.num_slots
        if n == total:
            return np.arange(total)
        if self.order == "sequential":
            return np.sort((step * n + np.arange(n)) % total)
        return np.sort(generator.choice(total, size=n, replace=False))


class _Table:
    """The episodes of all tasks one after another, each as long as it has steps.

    Args:
        ids: episodes of each task, at least one.
        lengths: of every episode of the file.
    """

    def __init__(
        self, ids: Sequence[NDArray[np.int64]], lengths: NDArray[np.int64], start_bias: int
    ) -> None:
        self._ids, self._bias = np.concatenate(ids), start_bias
        self._lengths = lengths[self._ids]
        self._ends = np.cumsum(self._lengths)
        self._num_steps = np.array([lengths[own].sum() for own in ids])
        self._before = np.cumsum(self._num_steps) - self._num_steps
        self._starts = (self._lengths + start_bias).astype(np.uint64)
        # numpy draws nothing from a range of one number, and two words from one beyond 32 bits.
        least = min(int(self._lengths.min()) + start_bias, int(self._num_steps.min()))
        most = max(int(self._lengths.max()) + start_bias, int(self._num_steps.max()))
        self._one_word_each = least > 1 and most < _WORDS

    def draw(
        self, generator: np.random.Generator, slots: NDArray[np.int64], count: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Episodes (n, count) and starts (n, count) of the tasks at `slots`."""
        episodes = np.empty((len(slots), count), np.int64)
        starts = np.empty_like(episodes)
        for row, slot in enumerate(slots):
            # A uniform step of all the task's steps lies in episode i with chance ∝ length i.
            steps = generator.integers(self._num_steps[slot], size=count)
            picks = self._owners(steps + self._before[slot])
            lowest = np.full(count, -self._bias)
            episodes[row] = self._ids[picks]
            starts[row] = generator.integers(lowest, self._lengths[picks])
        return episodes, np.maximum(starts, 0)

    def draw_at_once(
        self, generator: np.random.Generator, slots: NDArray[np.int64], count: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
        """The numbers of `draw`, for all tasks at once; None where numpy would have drawn again.

        A number below b is the upper half of word * b, unless the lower half is among the few
        that would make some numbers likelier (D. Lemire, 2019).
        """
        if not self._one_word_each:
            return None
        words = generator.integers(_WORDS, size=(len(slots), 2, count), dtype=np.uint32)
        steps = _below(words[:, 0], self._num_steps[slots].astype(np.uint64)[:, None])
        if steps is None:
            return None
        steps += self._before[slots][:, None]
        picks = self._owners(steps)
        starts = _below(words[:, 1], self._starts.take(picks))
        if starts is None:
            return None
        if self._bias:
            starts = np.maximum(starts - self._bias, 0)
        return self._ids.take(picks), starts

    def _owners(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Positions of the episodes in which these steps lie."""
        return np.searchsorted(self._ends, steps, side="right")


_WORDS = 1 << 32
_LOWER, _HALF = np.uint64(_WORDS - 1), np.uint64(32)


def _below(words: NDArray[np.uint32], bound: NDArray[np.uint64]) -> NDArray[np.int64] | None:
    """What `Generator.integers(bound)` makes of one word each; None if it wanted another word."""
    wide = words * bound
    left = wide & _LOWER
    if (left < bound).any() and (left < (np.uint64(_WORDS) - bound) % bound).any():
        return None
    wide >>= _HALF
    return wide.view(np.int64)
