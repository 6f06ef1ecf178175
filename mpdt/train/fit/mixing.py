"""Training tasks that act as if they were unseen, so that mixed prompts are what was trained.

    random episodes of task k  ─>  explained by pairs of other tasks: weights w, w_k = 0
    in `share` of an update's tasks   P_c o sum_j w_j P_j   stands in for   P_c o P_k

What `infer` does with an unseen task then happens thousands of times in training, on tasks whose
expert is known. No test task is read. A task that the others cannot explain, such as one at the
end of a range, always keeps its own prompt: training it on a neighbour's would spoil the latter.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import msgspec
import numpy as np
import torch
from torch import Tensor

from mpdt.errors import UsageError
from mpdt.train.fit.reward import (
    RewardModel,
    RewardSettings,
    Transitions,
    convex_fit,
    fit_reward_model,
)

NEIGHBOURS = 6


class MixingSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How often training tasks stand for unseen ones."""

    share: float = 0.0
    """Chance of a task in an update to act with the others' prompts; 0 = never."""
    unexplained: float = 0.05
    """Most of its rewards' variance that the others may leave unexplained."""
    model: RewardSettings = RewardSettings(tasks=2)
    """Reward model and number of tasks that are mixed together, as in `adapt.infer`."""

    def __post_init__(self) -> None:
        for name in ("share", "unexplained"):
            if not 0 <= getattr(self, name) <= 1:
                raise UsageError("setting out of range", where=f"mixing.{name}",
                                 expected="0 to 1", found=str(getattr(self, name)))  # fmt: skip


@torch.no_grad()
def held_out_mixtures(
    tasks: Sequence[Transitions],
    settings: MixingSettings,
    seed: int,
    on_step: Callable[[int, float], None] | None = None,
) -> list[Tensor]:
    """Per task k the ways in which others explain it: weights (m_k, N), sum 1, nothing at k.

    Of its `NEIGHBOURS` nearest tasks every `model.tasks` are tried together, so that prompts learn
    to be mixed and not just to be mixed in one way; m_k may be 0.

    Args:
        tasks: random episodes of the N training tasks, with rewards.
    """
    with torch.enable_grad():
        model = fit_reward_model(tasks, settings.model, seed, on_step)
    return [_mixtures(model, own, k, settings) for k, own in enumerate(tasks)]


def _mixtures(model: RewardModel, own: Transitions, k: int, settings: MixingSettings) -> Tensor:
    outputs = model(torch.from_numpy(own.inputs)).double().numpy()
    errors = np.square(outputs - own.rewards[:, None]).mean(axis=0)
    nearest = [j for j in np.argsort(errors).tolist() if j != k][:NEIGHBOURS]
    found = []
    for chosen in itertools.combinations(sorted(nearest), settings.model.tasks):
        weights = np.zeros(len(errors))
        weights[list(chosen)] = convex_fit(outputs[:, chosen], own.rewards)
        missed = np.square(outputs @ weights - own.rewards).mean()
        if np.count_nonzero(weights) == len(chosen) > 1 and (
            missed <= settings.unexplained * np.var(own.rewards)
        ):
            found.append(weights)
    return torch.tensor(np.reshape(found, (-1, len(errors))), dtype=torch.float32)
