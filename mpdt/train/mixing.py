"""Training tasks that act as if they were unseen, so that mixed prompts are what was trained.

    random episodes of task k  ─>  explained by the other tasks alone: weights w_k, w_kk = 0
    in `share` of an update's tasks   P_c o sum_j w_kj P_j   stands in for   P_c o P_k

What `infer` does with an unseen task then happens thousands of times in training, on tasks whose
expert is known. No test task is read. A task that the others cannot explain, such as one at the
end of a range, always keeps its own prompt: training it on a neighbour's would spoil the latter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import msgspec
import numpy as np
import torch
from torch import Tensor

from mpdt.errors import UsageError
from mpdt.train.infer import InferSettings, Transitions, explain, fit_reward_model


class MixingSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How often training tasks stand for unseen ones."""

    share: float = 0.0
    """Chance of a task in an update to act with the others' prompts; 0 = never."""
    unexplained: float = 0.05
    """Most of its rewards' variance that the others may leave unexplained."""
    model: InferSettings = InferSettings()
    """Reward model and number of tasks that are mixed, as in `adapt.infer`."""

    def __post_init__(self) -> None:
        for name in ("share", "unexplained"):
            if not 0 <= getattr(self, name) <= 1:
                raise UsageError("setting out of range", where=f"mixing.{name}",
                                 expected="0 to 1", found=str(getattr(self, name)))  # fmt: skip


def held_out_weights(
    tasks: Sequence[Transitions],
    settings: MixingSettings,
    seed: int,
    on_step: Callable[[int, float], None] | None = None,
) -> Tensor:
    """Weights (N, N): row k is how the other tasks explain task k, or a 1 at k itself.

    Args:
        tasks: random episodes of the N training tasks, with rewards.
    """
    model = fit_reward_model(tasks, settings.model, seed, on_step)
    weights = np.eye(len(tasks))
    for k, own in enumerate(tasks):
        found = explain(model, own, settings.model.tasks, banned=[k])
        mixes = np.count_nonzero(found.weights) > 1
        if mixes and found.unexplained <= settings.unexplained:
            weights[k] = found.weights
    return torch.from_numpy(weights).to(torch.float32)
