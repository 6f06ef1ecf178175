"""Which training tasks explain X? Our own zero-shot protocol: it reads X and X's rewards.

    random episodes of the training tasks  ─>  reward model: (s, a, s') -> one reward per task
    X of an unseen task with its rewards   ─>  how far off each task's output is
    the `tasks` nearest                    ─>  their convex combination that fits X best: w
    prompt                                 ─>  P_c o sum_k w_k P_k

or, by `steps`: a classifier of training tasks reads X step by step, w = the share of X that looks
like each.

Never read: actions of an expert of the unseen task, returns of trial policies on it. The
published protocol stays apart: rewards come through `open_tta_rewards` and are asked for only
where a start says so.

Why a convex combination of the nearest alone: with rewards -|v - g| and all speeds below g,
any mixture of goals whose mean is g fits as well, and prompts far apart do not average.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray

from mpdt.train.fit.classifier import TaskClassifier, fit_task_classifier
from mpdt.train.fit.reward import (
    RewardModel,
    RewardSettings,
    Transitions,
    convex_fit,
    fit_reward_model,
)


class InferSettings(RewardSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The model that is asked which training tasks X looks like, and how many may be mixed."""

    by: Literal["rewards", "steps"] = "rewards"
    """What of X tells: rewards = the tasks that pay as it was paid, by the reward model; steps =
    the tasks whose steps (observation, action, change, reward) its steps look like, by a classifier
    of the same size: for unseen goals of known classes. X is read with its rewards both times. Own
    episodes without X are told by rewards."""

    @property
    def facts(self) -> dict[str, Any]:
        """What counts, by name; as it was before there was a choice where it is the same."""
        found: dict[str, Any] = msgspec.to_builtins(self)
        if self.by == "rewards":
            del found["by"]
        return found


MODELS = {"rewards": "reward model", "steps": "task classifier"}
"""What is asked, by what of X tells."""


@dataclass(frozen=True)
class Explanation:
    """How the N training tasks explain one unseen task.

    errors (N,): how far off each is. By rewards: root mean square of (reward - output), the
        task's own unit; by steps: mean of -log(probability), nats.
    weights (N,): >= 0, sum 1, at most `InferSettings.tasks` of them above 0.
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


@torch.no_grad()
def recognise(classifier: TaskClassifier, x: Transitions, tasks: int) -> Explanation:
    """Weights of the training tasks for X, each step of which is a vote of the classifier.

    Args:
        tasks: how many of them may share the weight: those with the most of it, scaled to sum 1.
    """
    logs = classifier(torch.from_numpy(x.inputs), torch.from_numpy(x.rewards)).double().numpy()
    share = np.exp(logs).mean(axis=0)
    most = np.argsort(-share, kind="stable")[:tasks]
    weights = np.zeros(len(share))
    weights[most] = share[most] / share[most].sum()
    return Explanation(-logs.mean(axis=0), weights)


def explain_all(
    known: Sequence[Transitions], xs: Sequence[Transitions], settings: InferSettings, most: int,
    seed: int, on_step: Callable[[int, float], None] | None = None,
) -> list[Explanation]:  # fmt: skip
    """Each X by the training tasks, of which one model is fitted.

    Args:
        known: random episodes of the N training tasks.
        most: how many of them may share the weight.
        on_step: called with (updates done, loss).
    Raises: TrainingError if the loss is no number.
    """
    if settings.by == "steps":
        classifier = fit_task_classifier(known, settings, seed, on_step)
        return [recognise(classifier, x, most) for x in xs]
    model = fit_reward_model(known, settings, seed, on_step)
    return [explain(model, x, most) for x in xs]
