"""Which training tasks explain X? Our own zero-shot protocol: it reads X and X's rewards.

    random episodes of the training tasks  ─>  reward model: (s, a, s') -> one reward per task
    X of an unseen task with its rewards   ─>  how far off each task's output is
    the `tasks` nearest                    ─>  their convex combination that fits X best: w
    prompt                                 ─>  P_c o sum_k w_k P_k

Never read: actions of an expert of the unseen task, returns of trial policies on it. The
published protocol stays apart: rewards come through `open_tta_rewards` and are asked for only
where a start says so.

Why a convex combination of the nearest alone: with rewards -|v - g| and all speeds below g,
any mixture of goals whose mean is g fits as well, and prompts far apart do not average.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from mpdt.train.fit.reward import RewardModel, Transitions, convex_fit


@dataclass(frozen=True)
class Explanation:
    """How the N training tasks explain one unseen task.

    errors (N,): root mean square of (reward - output), the task's own unit.
    weights (N,): >= 0, sum 1, at most `RewardSettings.tasks` of them above 0.
    """

    errors: NDArray[np.float64]
    weights: NDArray[np.float64]

    def named(self, names: Sequence[str]) -> Mapping[str, float]:
        """The weights above 0 by the names of their tasks."""
        return {
            names[k]: round(float(self.weights[k]), 4)
            for k in np.flatnonzero(self.weights).tolist()
        }


@torch.no_grad()
def explain(
    model: RewardModel, x: Transitions, tasks: int, banned: Sequence[int] = ()
) -> Explanation:
    """Weights of the training tasks for X.

    Args:
        tasks: how many of them may share the weight.
        banned: columns that get none: the way to hold a training task out.
    """
    outputs = model(torch.from_numpy(x.inputs)).double().numpy()
    errors = np.sqrt(np.square(outputs - x.rewards[:, None]).mean(axis=0))
    order = np.argsort(np.where(np.isin(np.arange(len(errors)), banned), np.inf, errors))
    nearest = order[: min(tasks, len(order) - len(banned))]
    weights = np.zeros(len(errors))
    weights[nearest] = convex_fit(outputs[:, nearest], x.rewards)
    return Explanation(errors, weights)
