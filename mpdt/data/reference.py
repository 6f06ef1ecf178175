"""Reference: what a policy to compare with returns on one task, and how well that is known.

    zero       all-zero actions                      random   uniform actions
    constant   the best task-blind constant action   expert   the last rung of the ladder

random and expert are level 0 and 1; zero and constant are what a policy
reaches that has understood nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

REFERENCE_POLICIES = ("zero", "random", "constant", "expert")
Source = Literal["", "shipped", "local", "collected", "data"]


@dataclass(frozen=True)
class Reference:
    """Mean return of one policy on one task.

    Args:
        mean: summed reward of an episode, the task's own unit; NaN = never measured.
        error: standard error of `mean`; NaN with fewer than two episodes.
        success: share of successful episodes; None where nobody counted them.
        source: `shipped` with mpdt, `local` from a file of the working folder, `collected`
            from episodes of this very collection, `data` from foreign episodes that were called
            so; empty = not said.
    """

    mean: float = math.nan
    error: float = math.nan
    episodes: int = 0
    success: float | None = None
    source: Source = ""

    @classmethod
    def of(
        cls,
        returns: npt.NDArray[np.float64],
        successes: npt.NDArray[np.bool_] | None = None,
        source: Source = "collected",
    ) -> Reference:
        """Of the returns (N,) and successes (N,) of independent episodes; N may be 0.

        Three episodes of 1, 2 and 6: mean 3, variance 7, error sqrt(7 / 3).
        """
        if len(returns) == 0:
            return cls()
        spread = float(returns.std(ddof=1)) if len(returns) > 1 else math.nan
        return cls(
            mean=float(returns.mean()),
            error=spread / math.sqrt(len(returns)),
            episodes=len(returns),
            success=None if successes is None else float(successes.mean()),
            source=source,
        )

    @property
    def is_known(self) -> bool:
        return not math.isnan(self.mean)


UNKNOWN = Reference()


def level(value: float, random: float, expert: float) -> float:
    """Normalised return: 0 = uniform actions, 1 = the expert of the data.

    nan where one of the three is unknown or the expert is not above random: there is no scale.
    """
    return (value - random) / (expert - random) if expert > random else math.nan


@dataclass(frozen=True)
class References:
    """The references of one task by name of the policy; what is not there is unknown.

    `constant_action` is the action behind `constant`, empty where none was chosen.
    """

    by_name: Mapping[str, Reference] = field(default_factory=dict)
    constant_action: tuple[float, ...] = ()

    def __getitem__(self, name: str) -> Reference:
        return self.by_name.get(name, UNKNOWN)
