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
    gather_windows,
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
        self.start_bias, self.order = start_bias, order
        self.num_slots = min(tasks_per_update or len(tasks), len(tasks))
        self._dataset = dataset
        self._returns = RewardReturns(dataset, dataset.steps.rewards)
        self._tables = []
        lengths = np.asarray(dataset.episodes.length, np.int64)
        for task in tasks:
            ids = np.asarray(episode_ids.get(task, ()), np.int64)
            if not len(ids):
                raise DataError(
                    "no episode to train on",
                    where=f"task row {task}",
                    hint="mpdt-data show FILE --tasks lists what each task has",
                )
            self._tables.append(_Table(ids, lengths[ids]))

    def batch(self, step: int) -> WindowBatch:
        """The windows of update `step`: (n, M, K, ...), the same on every call."""
        generator = generator_at(self.seed, step)
        slots = self._slots(step, generator)
        episodes = np.empty((len(slots), self.per_task), np.int64)
        starts = np.empty_like(episodes)
        for row, slot in enumerate(slots):
            episodes[row], starts[row] = self._tables[slot].draw(
                generator, self.per_task, self.start_bias
            )
        return gather_windows(
            self._dataset, episodes, np.maximum(starts, 0), self.window, self._returns,
            self.tasks[slots], slots,
        )  # fmt: skip

    def _slots(self, step: int, generator: np.random.Generator) -> NDArray[np.int64]:
        """Ascending positions of the tasks of this update."""
        total, n = len(self.tasks), self.num_slots
        if n == total:
            return np.arange(total)
        if self.order == "sequential":
            return np.sort((step * n + np.arange(n)) % total)
        return np.sort(generator.choice(total, size=n, replace=False))


class _Table:
    """The episodes of one task: ids (E,) and lengths (E,)."""

    def __init__(self, ids: NDArray[np.int64], lengths: NDArray[np.int64]) -> None:
        self._ids, self._lengths, self._ends = ids, lengths, np.cumsum(lengths)
        self._num_steps = int(self._ends[-1])
        self._common = int(lengths[0]) if (lengths == lengths[0]).all() else 0

    def draw(
        self, generator: np.random.Generator, count: int, start_bias: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Episodes (count,) and starts (count,), of which negative ones mean 0."""
        # A uniform step of all the task's steps lies in episode i with chance ∝ length i.
        steps = generator.integers(self._num_steps, size=count)
        if self._common:  # the same numbers as below, in a third of the time
            starts = generator.integers(-start_bias, self._common, size=count)
            return self._ids[steps // self._common], starts
        picks = np.searchsorted(self._ends, steps, side="right")
        lowest = np.full(count, -start_bias)
        return self._ids[picks], generator.integers(lowest, self._lengths[picks])
