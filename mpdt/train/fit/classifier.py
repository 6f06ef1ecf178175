"""The task classifier: of which training task is a step?

    random episodes of the training tasks  ─>  (s, a, s' - s, r) -> one probability per task

Where tasks differ in what is seen, as the classes of Meta-World do, this tells them apart better
than what they pay (decision 0010).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from mpdt.train.fit.reward import (
    CLIP,
    RewardSettings,
    Transitions,
    fit_to_steps,
    together,
    two_hidden,
)


class TaskClassifier(nn.Module):
    """inputs (T, F), rewards (T,) -> log-probabilities (T, N), one column per training task."""

    mean: Tensor
    std: Tensor

    def __init__(self, tasks: Sequence[Transitions], hidden: int, seed: int) -> None:
        super().__init__()
        seen = np.concatenate([
            np.concatenate([task.inputs for task in tasks]),
            np.concatenate([task.rewards for task in tasks])[:, None],
        ], axis=1)  # fmt: skip
        std = np.maximum(seen.std(axis=0, dtype=np.float64), 1e-6)
        for name, value in (("mean", seen.mean(axis=0, dtype=np.float64)), ("std", std)):
            self.register_buffer(name, torch.as_tensor(value, dtype=torch.float32))
        self.net = two_hidden(seen.shape[1], hidden, len(tasks), seed)

    def logits(self, inputs: Tensor, rewards: Tensor) -> Tensor:
        seen = torch.cat([inputs, rewards[:, None]], dim=1)
        found: Tensor = self.net(((seen - self.mean) / self.std).clamp(-CLIP, CLIP))
        return found

    def forward(self, inputs: Tensor, rewards: Tensor) -> Tensor:
        return self.logits(inputs, rewards).log_softmax(dim=1)


def fit_task_classifier(
    tasks: Sequence[Transitions],
    settings: RewardSettings,
    seed: int,
    on_step: Callable[[int, float], None] | None = None,
) -> TaskClassifier:
    """Train it to name the task of every step; batches are a function of (seed, step).

    A task with many episodes is not likelier for that: how often each is drawn is added in the
    loss and left out when the classifier is asked (logit adjustment, Menon et al. 2021, eq. 10).

    Args:
        on_step: called with (updates done, cross-entropy in nats).
    Raises: TrainingError if the loss is no number.
    """
    model = TaskClassifier(tasks, settings.hidden, seed)
    inputs, rewards, column = together(tasks)
    drawn = torch.bincount(column, minlength=len(tasks)).double().log().float()

    def loss(pick: Tensor) -> Tensor:
        logits = model.logits(inputs[pick], rewards[pick]) + drawn
        return nn.functional.cross_entropy(logits, column[pick])

    fit_to_steps(model, loss, len(rewards), settings, seed, on_step, "the task classifier")
    return model
