"""Own trials where the simulator has no successes: a search over mixtures of prompts.

A planner inside a learned model is no match for a gait that a prompt knows. So after the first
trial has told which training tasks are near, each further one tries the best mixture so far moved
towards one of these, and what earned more is kept:

    moved by a share s towards task j     better  ->  the same again
                                          worse   ->  the next j; after the last one, with s / 2
    there already                         the next j, no trial is spent on it, unless all are there

Prompts are linear in the weights, so mixtures of prompts are mixtures of tasks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

SHARE = 0.3
"""Large enough to be seen in a single return, by which a mixture is judged: trials are few."""
NEAREST = 4
"""Training tasks that a mixture is moved towards, the nearest first: two rounds of ten trials."""


@dataclass(frozen=True)
class Move:
    """Towards the nearest task number `towards`, by `share` of the way."""

    towards: int
    share: float


def next_move(better: Sequence[bool], nearest: int = NEAREST) -> Move:
    """What to try after moves that were better or not than all before them.

    better False, False, True     ->   task 2 again, by 0.3
    """
    towards, share, since = 0, SHARE, 0
    for one in better:
        since = 0 if one else since + 1
        if one:
            continue
        towards = (towards + 1) % nearest
        if since >= nearest:
            share, since = share / 2, 0
    return Move(towards, share)


def next_mixture(
    prompts: Sequence[Tensor], earned: Sequence[float], before: int, near: Tensor
) -> tuple[Move, Tensor]:
    """The next move and the prompt (1, l, s) that it gives.

    Args:
        prompts, earned: what was tried, in order, each (1, l, s) with the return of its trial.
        before: how many of these came before the first move, at least 1.
        near (m, l, s): prompts of the nearest tasks.
    """
    better: list[bool] = []
    for n in range(before, len(earned) + 1):
        leader = prompts[max(range(n), key=lambda i: (earned[i], i))]
        for _ in near:
            move = next_move(better, len(near))
            if not torch.allclose(leader[0], near[move.towards]):
                break
            better.append(False)
        if n < len(earned):
            better.append(earned[n] > max(earned[:n]))
    return move, (1 - move.share) * leader + move.share * near[None, move.towards]
