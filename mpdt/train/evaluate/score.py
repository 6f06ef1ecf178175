"""Scores: what a method returned on a task, beside the references; results.json holds them.

A `Score` is one method on one task. Intervals are 95 % percentile bootstraps over the
evaluation seeds, over goals where episodes share a few of them; the interval of a mean over tasks
resamples the seeds inside every task, so it says how far other seeds would move the number, not
how far other tasks would.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from mpdt.data.reference import Reference, level
from mpdt.train.evaluate.aggregate import bootstrap, goal_means
from mpdt.train.evaluate.sealed import sealed

Block = Literal["train", "test"]
MEAN = "mean"
"""Name of the row that averages over the tasks of a block."""
ZERO, RANDOM, CONSTANT, EXPERT = "zero action", "random", "best constant", "expert"
REFERENCES = (ZERO, RANDOM, CONSTANT, EXPERT)
TRIVIAL = (ZERO, RANDOM)
"""Methods that any policy has to beat before it has learnt something."""
Reads = Literal["nothing", "task id", "X", "X+rewards", "labelled steps", "demonstration",
                "trials", "X+rewards, trials"]  # fmt: skip
"""What was read of a test task before its first step: which training task it is with another goal,
the set X, its simulator's rewards, labelled steps, own episodes with rewards and successes, ..."""


class Score(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One method on one task (or on the mean of a block's tasks)."""

    block: Block
    task: str
    method: str
    mean: float
    """Mean return, the task's own unit; nan = not measured."""
    low: float
    high: float
    """95 % interval over seeds, or of a reference by its error; nan where only a mean is known."""
    normalised: float
    """Its level."""
    success: float | None = None
    """Share of episodes with a successful step; None where the simulator has none."""
    num_episodes: int = 0
    beats_trivial: bool | None = None
    """Its interval lies above those of zero action and random; None = not compared."""
    reads: Reads | None = None
    """What was read of this task to make the policy; None for references and training tasks."""
    own_steps: float | None = None
    """Steps of own episodes that were read (of a mean: mean per task); None where none were."""


def scores_of(
    block: Block,
    method: str,
    tasks: Sequence[str],
    returns: NDArray[np.float64],
    successes: NDArray[np.bool_] | None,
    random: NDArray[np.float64],
    expert: NDArray[np.float64],
    reads: Reads | None = None,
    goals: int | None = None,
) -> list[Score]:
    """One score per task and one for their mean.

    Args:
        returns, successes: (n, E), as `evaluate` gives them.
        random, expert: (n,) reference returns of the file.
        goals: of a task, which its episodes take in turn; None = each has its own.
    """
    apart = returns if goals is None else goal_means(returns, goals)
    scores = []
    for i, task in enumerate(tasks):
        mean = float(returns[i].mean())
        low, high = _interval(apart[i : i + 1], returns)
        share = None if successes is None else float(successes[i].mean())
        reached = level(mean, float(random[i]), float(expert[i]))
        scores.append(Score(block=block, task=task, method=method, mean=mean, low=low, high=high,
                            normalised=reached, success=share, reads=reads,
                            num_episodes=returns.shape[1]))  # fmt: skip
    low, high = _interval(apart, returns)
    levels = [score.normalised for score in scores]
    share = None if successes is None else float(successes.mean())
    mean_score = Score(block=block, task=MEAN, method=method, mean=float(returns.mean()), low=low,
                       high=high, normalised=float(np.mean(levels)), success=share,
                       reads=reads, num_episodes=returns.size)  # fmt: skip
    return [*scores, mean_score]


def _interval(apart: NDArray[np.float64], returns: NDArray[np.float64]) -> tuple[float, float]:
    """Of episodes that all repeat one goal none is known; resampling one would call it certain."""
    if apart.shape[1] == 1 < returns.shape[1]:
        return (math.nan, math.nan)
    return bootstrap(apart)


def expert_scores(
    block: Block,
    tasks: Sequence[str],
    experts: Sequence[Reference],
    random: NDArray[np.float64],
) -> list[Score]:
    """The expert of the data: the reference in the file, which is not run again.

    Its interval is 1.96 standard errors to both sides: there are hundreds of episodes behind
    it. Errors of tasks are independent, so that of a mean over n is sqrt(sum of squares) / n.

    Args:
        experts: one per task; unknown = not measured at this horizon.
        random: (n,) mean returns of the file.
    """
    means, errors = (
        np.array([getattr(expert, name) for expert in experts]) for name in ("mean", "error")
    )
    groups = [(task, [i]) for i, task in enumerate(tasks)]
    scores = []
    for task, rows in [*groups, (MEAN, list(range(len(tasks))))]:
        mean = float(means[rows].mean())
        margin = 1.96 * float(np.sqrt((errors[rows] ** 2).sum())) / len(rows)
        shares = [success for i in rows if (success := experts[i].success) is not None]
        levels = [level(float(means[i]), float(random[i]), float(means[i])) for i in rows]
        scores.append(Score(block=block, task=task, method=EXPERT, mean=mean, low=mean - margin,
                            high=mean + margin, normalised=float(np.mean(levels)),
                            success=float(np.mean(shares)) if len(shares) == len(rows) else None,
                            num_episodes=sum(experts[i].episodes for i in rows)))  # fmt: skip
    return scores


def not_measured(block: Block, method: str, tasks: Sequence[str]) -> list[Score]:
    """Rows that say so."""
    nan = math.nan
    return [
        Score(block=block, task=task, method=method, mean=nan, low=nan, high=nan, normalised=nan)
        for task in [*tasks, MEAN]
    ]


def with_verdicts(scores: Sequence[Score]) -> list[Score]:
    """Fills in `beats_trivial` of every method that is no reference.

        zero action [0, 3]   random [-5, 1]      [4, 9] beats them      [2, 9] does not

    Not said where an interval is missing, or of one episode and therefore no interval.
    """
    at = {(score.block, score.task, score.method): score for score in scores}

    def verdict(score: Score) -> bool | None:
        trivial = [at.get((score.block, score.task, method)) for method in TRIVIAL]
        compared = [each for each in (score, *trivial) if each is not None]
        if len(compared) <= len(TRIVIAL) or any(
            each.num_episodes < 2 or not math.isfinite(each.low + each.high) for each in compared
        ):
            return None
        return all(score.low > each.high for each in compared[1:])

    return [
        score if score.method in (*TRIVIAL, CONSTANT, EXPERT)
        else msgspec.structs.replace(score, beats_trivial=verdict(score))
        for score in scores
    ]  # fmt: skip


def encode_results(header: Mapping[str, Any], scores: Sequence[Score]) -> bytes:
    """results.json under its digest: nan becomes null, so that any JSON reader takes it; the unsaid
    is absent."""
    rows = [
        {k: None if v != v else v for k, v in msgspec.structs.asdict(score).items()
         if v is not None or k not in ("beats_trivial", "reads", "own_steps")}
        for score in scores
    ]  # fmt: skip
    content = sealed({**header, "scores": rows})
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()
