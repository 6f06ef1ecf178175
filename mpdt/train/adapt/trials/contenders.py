"""Policies that a task's trials compare, and which of them the trials speak for.

With successes a contender is worth (s + 1) / (n + 2) after s of n tries: nothing known is 1/2.
Without (locomotion) it is worth its mean return, and nothing known is worth nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from torch import Tensor

from mpdt.model.policy import PromptPolicy

WORTH_TRYING = 0.5


@dataclass
class Contender:
    """One policy behind one prompt (1, l, s).

    Attributes:
        name: base, mean, "prompt 3", "clone 1", "moved 0.3 to TASK".
        returns: of its whole episodes; a trial that it only opened has none.
        successes: of all its tries; empty where the simulator has no successes.
        retired: it is not chosen any more.
    """

    name: str
    policy: PromptPolicy
    prompt: Tensor
    returns: list[float] = field(default_factory=list)
    successes: list[bool] = field(default_factory=list)
    retired: bool = False

    def was_tried(self, has_success: bool) -> bool:
        return bool(self.successes if has_success else self.returns)

    def worth(self, has_success: bool) -> float:
        if has_success:
            return (sum(self.successes) + 1) / (len(self.successes) + 2)
        return float(np.mean(self.returns)) if self.returns else -math.inf


def best(contenders: Sequence[Contender], has_success: bool) -> int:
    """Position of the one to act with: the worthiest; of several the higher mean return where both
    were tried in whole episodes, then the newest."""
    alive = [i for i, one in enumerate(contenders) if not one.retired]

    def key(i: int) -> tuple[float, float, int]:
        one = contenders[i]
        paid = float(np.mean(one.returns)) if one.returns and has_success else -math.inf
        return (one.worth(has_success), paid, i)

    return max(alive, key=key)
