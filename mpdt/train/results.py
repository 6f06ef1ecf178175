"""What a run leaves behind: metrics.jsonl while it goes, results.json when it is done.

A `Score` is one method on one task. Intervals are 95 % percentile bootstraps over the
evaluation seeds; the interval of a mean over tasks resamples the seeds inside every task,
so it says how far other seeds would move the number, not how far other tasks would.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from mpdt.errors import StorageError

RESAMPLES = 2000

Block = Literal["train", "test"]
MEAN = "mean"
"""Name of the row that averages over the tasks of a block."""


class Score(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One method on one task (or on the mean of a block's tasks)."""

    block: Block
    task: str
    method: str
    mean: float
    """Mean return, the task's own unit; nan = not measured."""
    low: float
    high: float
    """95 % bootstrap interval; nan where only a mean is known (references of the file)."""
    normalised: float
    """(return - random) / (expert - random)."""
    success: float | None = None
    """Share of episodes with a successful step; None where the simulator has none."""
    num_episodes: int = 0


def bootstrap(values: NDArray[np.float64], seed: int = 0) -> tuple[float, float]:
    """95 % interval of the mean over tasks of the mean over seeds, for `values` (n, E).

    Seeds are resampled inside each task. Source: Efron & Tibshirani 1993, chapter 13
    (percentile interval); too narrow for a handful of seeds, and honest about ties.
    """
    generator = np.random.Generator(np.random.PCG64(seed))
    n, E = values.shape
    picks = generator.integers(E, size=(RESAMPLES, n, E))
    means = values[np.arange(n)[:, None], picks].mean(axis=(1, 2))
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)


def normalised(mean: float, random: float, expert: float) -> float:
    """0 = uniform actions, 1 = the expert of the data; nan if the two do not differ."""
    return (mean - random) / (expert - random) if expert != random else float("nan")


def scores_of(
    block: Block,
    method: str,
    tasks: Sequence[str],
    returns: NDArray[np.float64],
    successes: NDArray[np.bool_] | None,
    random: NDArray[np.float64],
    expert: NDArray[np.float64],
) -> list[Score]:
    """One score per task and one for their mean.

    Args:
        returns, successes: (n, E), as `evaluate` gives them.
        random, expert: (n,) reference returns of the file.
    """
    scores = []
    for i, task in enumerate(tasks):
        mean = float(returns[i].mean())
        low, high = bootstrap(returns[i : i + 1])
        share = None if successes is None else float(successes[i].mean())
        level = normalised(mean, float(random[i]), float(expert[i]))
        scores.append(Score(block=block, task=task, method=method, mean=mean, low=low, high=high,
                            normalised=level, success=share,
                            num_episodes=returns.shape[1]))  # fmt: skip
    low, high = bootstrap(returns)
    levels = [score.normalised for score in scores]
    share = None if successes is None else float(successes.mean())
    mean_score = Score(block=block, task=MEAN, method=method, mean=float(returns.mean()), low=low,
                       high=high, normalised=float(np.mean(levels)), success=share,
                       num_episodes=returns.size)  # fmt: skip
    return [*scores, mean_score]


def reference_scores(
    block: Block,
    method: str,
    tasks: Sequence[str],
    means: NDArray[np.float64],
    random: NDArray[np.float64],
    expert: NDArray[np.float64],
) -> list[Score]:
    """Rows known only by their mean (n,): the references stored in the data file."""
    nan = float("nan")
    levels = [normalised(*map(float, row)) for row in zip(means, random, expert, strict=True)]
    rows = list(zip(tasks, map(float, means), levels, strict=True))
    rows.append((MEAN, float(np.mean(means)), float(np.mean(levels))))
    return [
        Score(
            block=block,
            task=task,
            method=method,
            mean=mean,
            low=nan,
            high=nan,
            normalised=level,
        )
        for task, mean, level in rows
    ]


class MetricsLog:
    """Append-only lines of JSON. `size_bytes` goes into checkpoints, `cut` undoes what came after.

    So a resumed run has exactly the lines of an unbroken one.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def size_bytes(self) -> int:
        return self.path.stat().st_size if self.path.exists() else 0

    def append(self, record: Mapping[str, Any]) -> None:
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(record) + "\n")
        except OSError as error:
            raise StorageError(f"cannot write: {error.strerror}", where=str(self.path)) from error

    def cut(self, size_bytes: int) -> None:
        """Forget every line behind the first `size_bytes`."""
        if self.size_bytes > size_bytes:
            os.truncate(self.path, size_bytes)

    def records(self) -> list[dict[str, Any]]:
        if not self.path.exists():
            return []
        return [json.loads(line) for line in self.path.read_text(encoding="utf-8").splitlines()]


def write_atomic(path: Path, content: bytes) -> None:
    """The old file or the new one, never half of it.

    Raises: StorageError if the disk is full or the folder cannot be written.
    """
    draft = path.with_name(path.name + ".tmp")
    try:
        with draft.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    except OSError as error:
        draft.unlink(missing_ok=True)
        raise StorageError(
            f"cannot write: {error.strerror}", where=str(path),
            hint="free some space or choose another folder with --runs-dir",
        ) from error  # fmt: skip


def encode_results(header: Mapping[str, Any], scores: Sequence[Score]) -> bytes:
    """results.json: nan becomes null, so that any JSON reader takes it."""
    rows = [
        {k: None if v != v else v for k, v in msgspec.structs.asdict(score).items()}
        for score in scores
    ]
    return (json.dumps({**header, "scores": rows}, indent=1, allow_nan=False) + "\n").encode()
