"""Treatment: checks on the numbers of one foreign episode, and the changes the user asked for.

A foreign file may hold anything, so nothing is taken on trust: shapes, dtypes, NaN, action
bounds, the one end flag, and whether a time limit is a time limit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.exchange.pickle_machine import kind_of
from mpdt.data.spec.tasks import FAMILIES, Family
from mpdt.errors import DataError, ShapeError, UsageError, quoted

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Rules:
    """How the numbers of a foreign file become episodes of a family.

    Args:
        horizon: steps after which the simulator cut an episode off.
        task, quality, license: of all episodes, where the files do not say; see `claims.py`.
        clip_actions: bring actions inside the bounds, as the simulator did, instead of
            refusing them.
        hide_goal: set the columns to 0 in which this family hides the goal.
        any_length: the format does not say how an episode ended, so one that is cut off before the
            horizon is no mistake.
        with_seeds: keep the seeds of resets, with which the family's environment begins again.
    Raises: UsageError.
    """

    format: str
    family: Family
    horizon: int
    task: str | None = None
    quality: str | None = None
    clip_actions: bool = False
    hide_goal: bool = False
    license: str = "NOASSERTION"
    any_length: bool = False
    with_seeds: bool = False

    def __post_init__(self) -> None:
        if self.horizon < 1:
            raise UsageError("too short", where="--horizon", expected="1 or more",
                             found=str(self.horizon))  # fmt: skip
        if self.hide_goal and not self.family.hidden_columns:
            raise UsageError(f"{self.family.name} hides no columns", where="--hide-goal",
                             hint="leave it out")  # fmt: skip


@dataclass(frozen=True)
class RawEpisode:
    """One episode as a file gave it: T steps, T+1 observations, nothing checked.

    Args:
        ends: (T,) or (T, 1), one flag for both kinds of end; or None where the file has both.
        terminations, truncations: both, or None where `ends` is given.
        goal: None = the task's own, or unknown.
        seed: of the reset that began it; None = not said, or the reset was told more.
    """

    observations: Any
    actions: Any
    rewards: Any
    ends: Any = None
    terminations: Any = None
    truncations: Any = None
    successes: Any = None
    goal: NDArray[np.float64] | None = None
    seed: int | None = None


@dataclass(frozen=True)
class Treated:
    """The checked arrays of an episode, in the dtypes of the file format, and what was changed.

    Args:
        clipped: number of action components outside the bounds.
        largest: the largest action as found, in absolute value.
    """

    observations: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float32]
    terminations: Flags
    truncations: Flags
    successes: Flags | None
    clipped: int
    largest: float


def treat(raw: RawEpisode, rules: Rules, where: str) -> Treated:
    """Check one episode and bring it to the form of its family.

    Args:
        where: file and episode, for the error.
    Raises: ShapeError for shapes and dtypes; DataError for NaN, flags, lengths, actions outside
        the bounds and goals that the family hides.
    """
    family = rules.family
    rewards = _numbers("rewards", raw.rewards, where).reshape(-1)
    length = len(rewards)
    check_length(length, rules, where)
    observations = _matrix("observations", raw.observations, length + 1,
                           family.observation_size, family, where)  # fmt: skip
    actions = _matrix("actions", raw.actions, length, family.action_size, family, where)
    terminations, truncations = _flags(raw, length, rules, where)
    successes = None if raw.successes is None else _flag("successes", raw.successes, length, where)
    outside = (actions < family.action_low) | (actions > family.action_high)
    clipped, largest = int(outside.sum()), float(np.abs(actions).max())
    if clipped and not rules.clip_actions:
        raise DataError(f"{clipped} numbers in actions outside the bounds", where=where,
                        expected=f"{family.action_low} to {family.action_high}",
                        found=f"up to {largest:.3g} in absolute value",
                        hint="the simulator clips them; do so too with --clip-actions")  # fmt: skip
    return Treated(
        observations=_hidden(observations, rules, where),
        actions=np.clip(actions, np.float32(family.action_low), np.float32(family.action_high)),
        rewards=rewards, terminations=terminations, truncations=truncations,
        successes=successes, clipped=clipped, largest=largest,
    )  # fmt: skip


def check_length(length: int, rules: Rules, where: str) -> None:
    """Raises: DataError for an episode without a step, or with more than the time limit."""
    if not 1 <= length <= rules.horizon:
        raise DataError("an episode of the wrong length", where=where,
                        expected=f"1 to {rules.horizon} steps", found=str(length),
                        hint=f"if it is whole: --horizon {quoted(length)}" if length else ""
                        )  # fmt: skip


def joined(observations: Any, next_observations: Any, where: str) -> Any:
    """T observations and the T that followed them as T+1 rows, in float32 as they are stored.

    Raises: ShapeError unless both are matrices of one shape; DataError for NaN, and where row t+1
        of one is not row t of the other: steps are missing, or two episodes were joined.
    """
    for name, array in (("observations", observations), ("next_observations", next_observations)):
        if not isinstance(array, np.ndarray) or array.ndim != 2 or not len(array):
            raise ShapeError(f"wrong {name}", where=where, expected="a matrix of T >= 1 rows",
                             found=kind_of(array))  # fmt: skip
    if observations.shape != next_observations.shape:
        raise ShapeError("observations and next_observations disagree", where=where,
                         expected=str(observations.shape),
                         found=str(next_observations.shape))  # fmt: skip
    before = _numbers("observations", observations, where)
    after = _numbers("next_observations", next_observations, where)
    wrong = np.flatnonzero((before[1:] != after[:-1]).any(axis=1))
    if len(wrong):
        step = int(wrong[0])
        raise DataError(f"the step after step {step} starts elsewhere", where=where,
                        expected="observations[t+1] = next_observations[t]",
                        found=f"{len(wrong)} steps where it is not")  # fmt: skip
    return np.concatenate([before, after[-1:]])


def _numbers(name: str, array: Any, where: str) -> NDArray[np.float32]:
    if not isinstance(array, np.ndarray) or array.dtype.kind != "f":
        raise ShapeError(f"wrong {name}", where=where, expected="an array of floats",
                         found=kind_of(array))  # fmt: skip
    if name == "rewards" and (
        array.ndim == 0 or array.shape not in ((len(array),), (len(array), 1))
    ):
        raise ShapeError("wrong rewards", where=where, expected="(T,) or (T, 1)",
                         found=str(array.shape))  # fmt: skip
    with np.errstate(over="ignore"):  # what float32 cannot hold is refused with the infinities
        numbers = np.ascontiguousarray(array, dtype="<f4")
    wrong = np.argwhere(~np.isfinite(numbers))
    if len(wrong):
        raise DataError(f"{len(wrong)} numbers in {name} are NaN or infinite", where=where,
                        found=f"first at {tuple(wrong[0].tolist())}")  # fmt: skip
    return numbers


def _matrix(
    name: str, array: Any, rows: int, columns: int, family: Family, where: str
) -> NDArray[np.float32]:
    numbers = _numbers(name, array, where)
    if numbers.shape != (rows, columns):
        size = "observation_size" if name == "observations" else "action_size"
        width = numbers.shape[1] if numbers.ndim == 2 else -1
        fits = [other for other in FAMILIES if getattr(FAMILIES[other], size) == width]
        hint = f"{width} columns fit {', '.join(fits)}" if fits and width != columns else ""
        raise ShapeError(f"wrong {name}", where=where,
                         expected=f"shape ({rows}, {columns}) in {family.name}",
                         found=str(numbers.shape), hint=hint)  # fmt: skip
    return numbers


def _flag(name: str, array: Any, length: int, where: str) -> Flags:
    """(T,) bool of booleans or of numbers that are 0 or 1."""
    good = isinstance(array, np.ndarray) and array.shape in ((length,), (length, 1))
    if not good or array.dtype.kind not in "biuf" or not np.isin(array, (0, 1)).all():
        raise ShapeError(f"wrong {name}", where=where, expected=f"{length} flags, 0 or 1",
                         found=kind_of(array))  # fmt: skip
    return np.ascontiguousarray(array.reshape(-1), dtype=bool)


def _flags(raw: RawEpisode, length: int, rules: Rules, where: str) -> tuple[Flags, Flags]:
    """Which end it was. A file with one flag for both sets it at time limits too."""
    if raw.ends is None:
        terminations = _flag("terminations", raw.terminations, length, where)
        truncations = _flag("truncations", raw.truncations, length, where)
    else:
        ends = _flag("terminals", raw.ends, length, where)
        at_limit = np.arange(1, length + 1) == rules.horizon
        terminations, truncations = ends & ~at_limit, ends & at_limit
    rows = np.flatnonzero(terminations | truncations).tolist()
    if rows != [length - 1]:
        raise DataError("an episode ends exactly once, on its last row", where=where,
                        expected=f"an end flag on row {length - 1} only",
                        found=f"rows {rows[:6]}")  # fmt: skip
    if truncations[-1] and length != rules.horizon and not rules.any_length:
        raise DataError("cut off before the time limit", where=where,
                        expected=f"{rules.horizon} steps", found=str(length),
                        hint=f"if that was its limit: --horizon {quoted(length)}")  # fmt: skip
    if terminations[-1] and not rules.family.ends_early:
        raise DataError(f"{rules.family.name} has no end but its time limit", where=where,
                        expected=f"{rules.horizon} steps", found=str(length),
                        hint=f"if that was its limit: --horizon {quoted(length)}")  # fmt: skip
    return terminations, truncations


def _hidden(observations: NDArray[np.float32], rules: Rules, where: str) -> NDArray[np.float32]:
    columns = list(rules.family.hidden_columns)
    if not observations[:, columns].any():
        return observations
    if not rules.hide_goal:
        raise DataError(f"columns {columns} show the goal", where=where,
                        expected=f"zeros, since {rules.family.name} hides it",
                        hint="set them to 0 with --hide-goal, or name a family that shows it, "
                             "such as mt50")  # fmt: skip
    observations = observations.copy()
    observations[:, columns] = 0.0
    return observations
