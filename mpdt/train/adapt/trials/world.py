"""The learned world model: (observation, action) -> change of the observation, reward.

    training tasks' random and good steps  -> dynamics shared, one reward head a task   (once)
    own trials of an unseen task           -> the same dynamics, and a reward head of its own

E small networks learn from different batches; a trial is planned with one of them, drawn anew
(Thompson sampling), so that what they disagree about gets tried.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mpdt.errors import TrainingError
from mpdt.seeding import generator_at, torch_generator
from mpdt.train.adapt.trials.features import Features
from mpdt.train.adapt.trials.settings import WorldSettings

_CLIP = 5.0  # standard deviations of a change: contacts have heavy tails


@dataclass(frozen=True)
class Steps:
    """T steps of any tasks.

    observations, first, following: (T, D) before the step, of its episode's beginning, after it.
    actions (T, A) as executed, rewards (T,), tasks (T,) number of the reward head.
    """

    observations: Tensor
    first: Tensor
    following: Tensor
    actions: Tensor
    rewards: Tensor
    tasks: Tensor

    def __len__(self) -> int:
        return len(self.rewards)

    @staticmethod
    def joined(parts: list[Steps]) -> Steps:
        columns = ("observations", "first", "following", "actions", "rewards", "tasks")
        return Steps(*(torch.cat([getattr(part, name) for part in parts]) for name in columns))


class WorldModel(nn.Module):
    """E networks of two hidden layers: (E, B, F) -> changes (E, B, M), reward heads (E, B, R).

    Args:
        steps: of the training tasks; scales come from them.
        heads: R, their number.
    """

    def __init__(
        self, features: Features, steps: Steps, heads: int, settings: WorldSettings, seed: int
    ) -> None:
        super().__init__()
        self.features, self.settings = features, settings
        self.reward_mean = float(steps.rewards.mean())
        self.reward_std = max(float(steps.rewards.std()), 1e-6)
        self.least, self.most = float(steps.rewards.min()), float(steps.rewards.max())
        width = features.inputs(steps.observations[:1], steps.first[:1], steps.actions[:1]).shape[1]
        generator, E, h = torch_generator(seed), settings.members, settings.hidden
        self.num_changes = len(features.moving)

        def layer(inputs: int, outputs: int) -> nn.ParameterList:
            weight = torch.randn((E, inputs, outputs), generator=generator) * (2 / inputs) ** 0.5
            return nn.ParameterList([weight, torch.zeros(E, 1, outputs)])

        self.first, self.second = layer(width, h), layer(h, h)
        self.change, self.reward = layer(h, self.num_changes), layer(h, heads)
        with torch.no_grad():
            for last in (self.change, self.reward):
                last[0].mul_(0.1)

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Changes and rewards, both in units of their spread."""
        hidden = inputs
        for layer in (self.first, self.second):
            hidden = torch.baddbmm(layer[1], hidden, layer[0]).relu()
        return (torch.baddbmm(self.change[1], hidden, self.change[0]),
                torch.baddbmm(self.reward[1], hidden, self.reward[0]))  # fmt: skip

    def pick(self, member: int) -> Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]:
        """One member alone: (observations (B, D), first (B, D), actions (B, A)) -> the next
        observations and the raw rewards (B,) of head 0."""
        layers = [(layer[0][member], layer[1][member]) for layer in (self.first, self.second)]
        change = (self.change[0][member], self.change[1][member])
        reward = (self.reward[0][member, :, 0], self.reward[1][member, 0, 0])

        def step(observations: Tensor, first: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
            hidden = self.features.inputs(observations, first, actions)
            for weight, bias in layers:
                hidden = torch.addmm(bias, hidden, weight).relu_()
            changes = torch.addmm(change[1], hidden, change[0]).clamp_(-_CLIP, _CLIP)
            paid = self.reward_mean + self.reward_std * (torch.mv(hidden, reward[0]) + reward[1])
            return self.features.advance(observations, changes), paid.clamp_(self.least, self.most)

        return step

    @torch.no_grad()
    def paid(self, steps: Steps) -> NDArray[np.float64]:
        """What each head would pay for these steps (T, R), mean of the members, raw."""
        inputs = self.features.inputs(steps.observations, steps.first, steps.actions)
        _, rewards = self(inputs.expand(self.settings.members, *inputs.shape))
        raw = self.reward_mean + self.reward_std * rewards.mean(dim=0)
        return np.asarray(raw.numpy(), np.float64)


def pretrain(
    features: Features, steps: Steps, heads: int, settings: WorldSettings, seed: int,
    on_step: Callable[[int, float], None] | None = None,
) -> WorldModel:  # fmt: skip
    """A world model of the training tasks; a function of steps, settings and seed."""
    model = WorldModel(features, steps, heads, settings, seed)

    def draw(generator: np.random.Generator) -> NDArray[np.int64]:
        return generator.integers(len(steps), size=(settings.members, settings.batch))

    _fit(model, steps, settings.pretraining, draw, seed, on_step)
    return model


def refit(model: WorldModel, steps: Steps, newest: int, updates: int, seed: int) -> WorldModel:
    """Another model with one head, for one unseen task; `model` stays as it is.

    The head of a pretrained model begins as that of the training task which pays likest. A quarter
    of every batch comes from the tenth of the steps that paid best: they are rare, and what it is
    about. Another quarter comes from the newest.

    Args:
        newest: how many of the last steps are new.
    """
    own, settings = copy.deepcopy(model), model.settings
    if own.reward[0].shape[2] > 1:
        away = np.square(model.paid(steps) - steps.rewards.double().numpy()[:, None]).mean(axis=0)
        nearest = int(away.argmin())
        own.reward = nn.ParameterList(
            [nn.Parameter(value[:, :, nearest : nearest + 1].detach().clone())
             for value in own.reward]
        )  # fmt: skip
    T, quarter = len(steps), settings.batch // 4
    best = np.argsort(steps.rewards.numpy(), kind="stable")[-max(1, T // 10) :]

    def draw(generator: np.random.Generator) -> NDArray[np.int64]:
        rare = best[generator.integers(len(best), size=(settings.members, quarter))]
        new = generator.integers(T - newest, T, size=(settings.members, quarter))
        rest = generator.integers(T, size=(settings.members, settings.batch - 2 * quarter))
        return np.concatenate([rare, new, rest], axis=1)

    alone = Steps(steps.observations, steps.first, steps.following, steps.actions, steps.rewards,
                  torch.zeros_like(steps.tasks))  # fmt: skip
    _fit(own, alone, updates, draw, seed)
    return own


def _fit(
    model: WorldModel, steps: Steps, updates: int,
    draw: Callable[[np.random.Generator], NDArray[np.int64]], seed: int,
    on_step: Callable[[int, float], None] | None = None,
) -> None:  # fmt: skip
    """Least squares on changes and rewards; batches are a function of (seed, update).

    Raises: TrainingError if the loss is no number.
    """
    features = model.features
    inputs = features.inputs(steps.observations, steps.first, steps.actions)
    moved = (steps.following - steps.observations)[:, features.moving] / features.change
    moved = moved.clamp(-_CLIP, _CLIP)
    paid = (steps.rewards - model.reward_mean) / model.reward_std
    optimizer = torch.optim.Adam(model.parameters(), lr=model.settings.lr)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, updates)
    for step in range(updates):
        pick = torch.from_numpy(draw(generator_at(seed, step)))
        changes, rewards = model(inputs[pick])
        of_task = rewards.gather(2, steps.tasks[pick][:, :, None])[:, :, 0]
        loss = (changes - moved[pick]).square().mean() + (of_task - paid[pick]).square().mean()
        if not torch.isfinite(loss):
            raise TrainingError(f"the world model's loss is {loss.item()} at update {step}",
                                where="adapt.trials.world",
                                hint="lower --adapt.trials.world.lr")  # fmt: skip
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        schedule.step()
        if on_step:
            on_step(step + 1, loss.item())
