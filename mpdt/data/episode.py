"""Episode: what one reset-to-end gave, as frozen arrays that keep their promises."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.errors import DataError, ShapeError
from mpdt.seeding import Quality

QUALITY_CODES: dict[str, int] = {
    quality.name.lower(): int(quality)
    for quality in (
        Quality.RANDOM,
        Quality.MEDIUM,
        Quality.EXPERT,
        Quality.HISTORY,
        Quality.POLICY,
    )
}
"""By name; `policy` is of roll-outs, the others are collected."""
UNKNOWN_QUALITY = -1
UNKNOWN_PROGRESS = -1.0
UNKNOWN_POLICY = bytes(32)

_NUM_AXES = {"observations": 2, "actions": 2, "rewards": 1, "goal": 1}
_NUM_AXES |= {"terminations": 1, "truncations": 1, "successes": 1}
_DTYPES: dict[str, Any] = {"observations": np.float32, "actions": np.float32}
_DTYPES |= {"rewards": np.float32, "terminations": np.bool_, "truncations": np.bool_}
_DTYPES |= {"successes": np.bool_, "goal": np.float64}


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode of T >= 1 steps.

        row              0    1   ..  T-1   T
        observations    o_0  o_1  ..  ...  o_T     (T+1, D) float32, the family's units
        actions         a_0  a_1  ..  a_T-1        (T, A)   float32, as given to `env.step`
        rewards         r_0  r_1  ..  r_T-1        (T,)     float32, reward of that step
        terminations     0    0   ..  0/1          (T,)     bool, the env's own rule ended it
        truncations      0    0   ..  0/1          (T,)     bool, the horizon was reached
        successes                                  (T,)     bool, or None without success

    Args:
        task: position in the family's task list, not a row of a file.
        goal: (G,) float64; direction, m/s, rad or Meta-World's reset vector.
        quality: a `mpdt.seeding.Quality` code, -1 unknown.
        progress: place of the acting rung, 0 untrained to 1 final; -1 unknown.
        policy: 32-byte hash of the acting policy.
        seed_key: (family, task, quality, block, row); 4294967295 = unknown. With the quality
            RECORDED block and row say where in the spec the seed stands.

    Exactly the last row has an end flag; both flags may be set there.

    Raises: ShapeError for shapes and dtypes, DataError for flags and out-of-range numbers.
    """

    observations: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float32]
    terminations: NDArray[np.bool_]
    truncations: NDArray[np.bool_]
    successes: NDArray[np.bool_] | None
    task: int
    goal: NDArray[np.float64] = field(repr=False)
    quality: int
    progress: float
    policy: bytes = field(repr=False)
    seed_key: tuple[int, int, int, int, int]

    def __post_init__(self) -> None:
        for column in fields(self):
            name = column.name
            if name in _DTYPES and getattr(self, name) is not None:
                self._check_array(name, getattr(self, name))
        self._check_lengths()
        ends = self.terminations | self.truncations
        if not ends[-1] or ends[:-1].any():
            found = np.flatnonzero(ends).tolist()
            raise DataError(
                "an episode ends exactly once, on its last row", where=self._where(),
                expected=f"an end flag on row {self.length - 1} only", found=f"rows {found}",
            )  # fmt: skip
        if len(self.policy) != 32 or len(self.seed_key) != 5:
            raise DataError(
                "policy hash or seed key has the wrong size", where=self._where(),
                expected="32 bytes and 5 numbers",
                found=f"{len(self.policy)} bytes and {len(self.seed_key)} numbers",
            )  # fmt: skip
        if not (self.progress == UNKNOWN_PROGRESS or 0.0 <= self.progress <= 1.0):
            raise DataError(
                "progress out of range", where=self._where(),
                expected="0 to 1, or -1 for unknown", found=repr(self.progress),
            )  # fmt: skip

    def _where(self) -> str:
        return f"episode {tuple(int(number) for number in self.seed_key)}"

    def _check_array(self, name: str, array: object) -> None:
        wanted = f"{_NUM_AXES[name]} axes of {np.dtype(_DTYPES[name])}"
        if not isinstance(array, np.ndarray):
            found = type(array).__name__
        elif array.ndim == _NUM_AXES[name] and array.dtype == _DTYPES[name]:
            return
        else:
            found = f"shape {array.shape} of {array.dtype}"
        raise ShapeError(f"wrong {name}", where=self._where(), expected=wanted, found=found)

    def _check_lengths(self) -> None:
        length = len(self.rewards)
        wanted = {"observations": length + 1, "actions": length}
        wanted |= {"terminations": length, "truncations": length, "successes": length}
        found = {n: len(getattr(self, n)) for n in wanted if getattr(self, n) is not None}
        wrong = {name: rows for name, rows in found.items() if rows != wanted[name]}
        if length < 1 or wrong:
            raise ShapeError(
                "columns of different lengths" if wrong else "an episode has at least one step",
                where=self._where(),
                expected=f"T+1 observations and T = {length} rows elsewhere, T >= 1",
                found=", ".join(f"{name} {rows}" for name, rows in (wrong or found).items()),
            )  # fmt: skip

    @property
    def length(self) -> int:
        """Number of steps T."""
        return len(self.rewards)

    @property
    def episode_return(self) -> float:
        """Sum of rewards: float64 sum of the stored float32 numbers."""
        return float(self.rewards.sum(dtype=np.float64))

    @property
    def success(self) -> bool:
        """Any step successful; False where the env has no success."""
        return self.successes is not None and bool(self.successes.any())


@dataclass(frozen=True)
class PolicyInfo:
    """Who acted: one row of `/policies`.

    Args:
        hash: SHA-256 of the weights, or of the JSON that defines a scripted policy.
        task: the owning task's position in the family's list.
        rung: place on its ladder, 0 untrained.
        level: normalised return, 0 random to 1 final.
        train_step: environment steps of training behind it; -1 if scripted.
        mix_rate: chance per step of a uniform action.
    """

    hash: bytes
    task: int
    rung: int
    level: float
    train_step: int
    mix_rate: float
    name: str


def returns_to_go(rewards: NDArray[np.float32]) -> NDArray[np.float32]:
    """Undiscounted sum of rewards from each step to the end of one episode, shape (T,).

        step      0   1   2
        rewards   1   2   3
        result    6   5   3

    Unit: the task's own reward, unscaled. Summed in float64, returned as float32.
    Does not: cross episodes, discount, pad.
    Raises: ShapeError if `rewards` is empty or not one-dimensional.
    Source: Chen et al. 2021, section 3.
    """
    if rewards.ndim != 1 or len(rewards) == 0:
        raise ShapeError("returns-to-go need rewards", expected="shape (T,), T >= 1",
                         found=str(rewards.shape))  # fmt: skip
    sums = np.cumsum(rewards[::-1], dtype=np.float64)[::-1]
    return np.ascontiguousarray(sums, dtype=np.float32)
