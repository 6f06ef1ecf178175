"""The reward model: what every training task would pay for a step of any of them.

    random episodes of the training tasks  ─>  (s, a, s') -> one reward per task

Used by `mixing`, which explains training tasks by each other, and by adaptation, which explains
unseen ones (`adapt/infer.py`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mpdt.data.slices.windows import WindowSource
from mpdt.errors import DataError, TrainingError, check_above_zero, check_at_least, quoted
from mpdt.seeding import generator_at, layers_from
from mpdt.train.fit.data import Ids, Material

CLIP = 10.0  # standard deviations; an unseen task may show what no training task did


class RewardSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The reward model and how many training tasks may be mixed."""

    tasks: int = 1
    """Training tasks that may share the weight: 1 = the nearest alone. More only where prompts were
    made to be averaged: `prompts.task_init` ones, or `mixing`."""
    hidden: int = 128
    """Width of the two hidden layers."""
    steps: int = 3000
    """Updates of that model."""
    batch: int = 1024
    """Transitions per update."""
    lr: float = 2e-3

    def __post_init__(self) -> None:
        for name in ("tasks", "hidden", "steps", "batch"):
            check_at_least(f"adapt.infer.{name}", getattr(self, name), 1)
        check_above_zero("adapt.infer.lr", self.lr)


@dataclass(frozen=True)
class Transitions:
    """T steps: inputs (T, 2 D + A) = observation, action, change of the observation; rewards (T,).

    Raw units. Actions as the simulator executed them.
    """

    inputs: NDArray[np.float32]
    rewards: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.rewards)


def read_transitions(
    source: WindowSource, ids: Ids, rewards: NDArray[Any], low: float, high: float
) -> Transitions:
    """All steps of the episodes `ids`, in order."""
    episodes = source.episodes
    length = np.asarray(episodes.length, np.int64)[ids]
    first = np.repeat(np.cumsum(length) - length, length)
    step = np.arange(int(length.sum())) - first
    at = np.repeat(np.asarray(episodes.start, np.int64)[ids], length) + step
    seen = np.repeat(np.asarray(episodes.obs_start, np.int64)[ids], length) + step
    now, then = source.steps.observations[seen], source.steps.observations[seen + 1]
    actions = np.clip(source.steps.actions[at], low, high)
    inputs = np.concatenate([now, actions, then - now], axis=1).astype(np.float32)
    return Transitions(inputs, np.asarray(rewards[at], np.float32))


def read_training_tasks(material: Material) -> list[Transitions]:
    """The random episodes of every training task.

    Raises: DataError if the file holds none, or a step in them is no number.
    """
    dataset, ids, family = material.dataset, material.random_ids(), material.family
    tasks = [
        read_transitions(
            dataset, ids[row], dataset.steps.rewards, family.action_low, family.action_high
        )
        for row in material.train_rows
    ]
    for row, task in zip(material.train_rows, tasks, strict=True):
        if not (np.isfinite(task.inputs).all() and np.isfinite(task.rewards).all()):
            raise DataError("a random episode has what is no number", where=str(dataset.path),
                            found=f"task {dataset.tasks.names[row]}",
                            hint=f"mpdt-data verify {quoted(dataset.path)} says which"
                            )  # fmt: skip
    return tasks


def two_hidden(inputs: int, hidden: int, outputs: int, seed: int) -> nn.Sequential:
    """Two hidden layers; numbers of `seed`."""
    with layers_from(seed):
        return nn.Sequential(
            nn.Linear(inputs, hidden), nn.GELU(),
            nn.Linear(hidden, hidden), nn.GELU(), nn.Linear(hidden, outputs),
        )  # fmt: skip


class RewardModel(nn.Module):
    """inputs (T, F) -> rewards (T, N), one column per training task, behind one shared trunk."""

    mean: Tensor
    std: Tensor
    reward_mean: Tensor
    reward_std: Tensor

    def __init__(self, tasks: Sequence[Transitions], hidden: int, seed: int) -> None:
        super().__init__()
        inputs = np.concatenate([task.inputs for task in tasks])
        rewards = np.concatenate([task.rewards for task in tasks])
        std = np.maximum(inputs.std(axis=0, dtype=np.float64), 1e-6)
        for name, value in (
            ("mean", inputs.mean(axis=0, dtype=np.float64)), ("std", std),
            ("reward_mean", rewards.mean(dtype=np.float64)),
            ("reward_std", max(float(rewards.std(dtype=np.float64)), 1e-6)),
        ):  # fmt: skip
            self.register_buffer(name, torch.as_tensor(value, dtype=torch.float32))
        self.net = two_hidden(inputs.shape[1], hidden, len(tasks), seed)

    def forward(self, inputs: Tensor) -> Tensor:
        seen = ((inputs - self.mean) / self.std).clamp(-CLIP, CLIP)
        rewards: Tensor = self.reward_mean + self.reward_std * self.net(seen)
        return rewards


def fit_reward_model(
    tasks: Sequence[Transitions],
    settings: RewardSettings,
    seed: int,
    on_step: Callable[[int, float], None] | None = None,
) -> RewardModel:
    """Train each column on its own task's transitions; batches are a function of (seed, step).

    Args:
        on_step: called with (updates done, loss in units of the rewards' variance).
    Raises: TrainingError if the loss is no number.
    """
    model = RewardModel(tasks, settings.hidden, seed)
    inputs, rewards, column = together(tasks)

    def loss(pick: Tensor) -> Tensor:
        found: Tensor = model(inputs[pick]).gather(1, column[pick, None])[:, 0]
        return ((found - rewards[pick]) / model.reward_std).square().mean()

    fit_to_steps(model, loss, len(rewards), settings, seed, on_step, "the reward model")
    return model


def together(tasks: Sequence[Transitions]) -> tuple[Tensor, Tensor, Tensor]:
    """The steps of all tasks one after another: inputs (T, F), rewards (T,), task numbers (T,)."""
    return (
        torch.from_numpy(np.concatenate([task.inputs for task in tasks])),
        torch.from_numpy(np.concatenate([task.rewards for task in tasks])),
        torch.from_numpy(np.repeat(np.arange(len(tasks)), [len(task) for task in tasks])),
    )


def fit_to_steps(
    model: nn.Module, loss_of: Callable[[Tensor], Tensor], num_steps: int,
    settings: RewardSettings, seed: int, on_step: Callable[[int, float], None] | None, name: str,
) -> None:  # fmt: skip
    """`settings.steps` updates of AdamW with a cosine; batch k is a function of (seed, k).

    Args:
        loss_of: loss of the steps with these numbers, below `num_steps`.
        name: of the model, for the error.
    Raises: TrainingError if the loss is no number.
    """
    optimizer = torch.optim.AdamW(model.parameters(), lr=settings.lr, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, settings.steps)
    for step in range(settings.steps):
        generator = generator_at(seed, step)
        pick = torch.from_numpy(generator.integers(num_steps, size=settings.batch))
        loss = loss_of(pick)
        if not torch.isfinite(loss):
            raise TrainingError(f"{name}'s loss is {loss.item()} at step {step}",
                                where="adapt.infer", hint="lower --adapt.infer.lr")  # fmt: skip
        optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        optimizer.step()
        schedule.step()
        if on_step:
            on_step(step + 1, loss.item())


def convex_fit(columns: NDArray[np.float64], target: NDArray[Any]) -> NDArray[np.float64]:
    """Weights w >= 0 of sum 1 that minimise |target - columns w|; columns (T, m), m small.

    Exact: least squares on every subset of the columns, the best of those without a negative
    weight.       columns (0 0), (4 4)   target (1 1)   ->   w = (0.75, 0.25)
    """
    best, weights = np.inf, np.zeros(columns.shape[1])
    for size in range(1, columns.shape[1] + 1):
        for subset in itertools.combinations(range(columns.shape[1]), size):
            first, rest = columns[:, subset[0]], columns[:, subset[1:]]
            others = np.linalg.lstsq(rest - first[:, None], target - first, rcond=None)[0]
            own = np.concatenate([[1 - others.sum()], others])
            error = float(np.square(target - columns[:, subset] @ own).sum())
            if (own >= 0).all() and error < best:
                best, weights = error, np.zeros(columns.shape[1])
                weights[list(subset)] = own
    return weights
