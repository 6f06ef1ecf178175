"""The echo of trained prompts: a small network that answers as the policy behind them would.

    windows of training tasks' episodes and of own trials
        -> the policy behind each of V prompts: actions at every step (T, V, A)
        -> one network: observation, first of the episode -> (V, A)

The planner lets the prompts act inside the world model thousands of times a trial. The policy
itself would take most of a trial's time; its echo costs as little as the model does. What acts in
the simulator and is judged is always the policy.
"""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from mpdt.data.slices.windows import constant_returns, cover, gather_windows
from mpdt.model.policy import PolicyBatch, PromptPolicy
from mpdt.model.returns import ReturnTable
from mpdt.seeding import generator_at, layers_from
from mpdt.train.adapt.trials.features import Features
from mpdt.train.adapt.trials.lived import Lived

HIDDEN, BATCH, LR = 200, 256, 1e-3
AT_ONCE = 64  # windows that go through the policy together


@torch.no_grad()
def answers(
    policy: PromptPolicy, prompts: Tensor, returns: ReturnTable, lived: Lived, window: int,
    on_windows: Callable[[int, int], None] = lambda done, of: None,
) -> Tensor:  # fmt: skip
    """What the policy would do at every step behind each of V prompts (T, V, A), in order.

    Windows hold every step once, so a step sees between none and K - 1 steps before it.

    Args:
        returns: V rows; the target is asked for at every step.
        on_windows: told (windows done, their number); may raise to stop.
    """
    V, places = len(prompts), lived.episodes
    wished = torch.zeros(len(lived.steps.rewards), V, policy.action_size)
    ids, starts = cover(places.length, np.arange(len(lived)), window)
    asked = constant_returns(np.full(len(lived), float(returns.target[0])))
    for at in range(0, len(ids), AT_ONCE):
        on_windows(at, len(ids))
        own, first = ids[at : at + AT_ONCE], starts[at : at + AT_ONCE]
        windows = gather_windows(lived, own[None], first[None], window, asked)
        batch = PolicyBatch.from_windows(windows)
        shown = (batch.observations, batch.previous_actions, batch.returns_to_go,
                 batch.timesteps, batch.mask)  # fmt: skip
        many = PolicyBatch(*(value.expand(V, *value.shape[1:]) for value in shown))
        actions = policy(many, prompts, returns).actions.float()  # (V, M, K, A)
        real = batch.mask[0]
        steps = torch.from_numpy(places.start[own])[:, None] + batch.timesteps[0]
        wished[steps[real]] = actions[:, real].transpose(0, 1)
    return wished


class Echo(nn.Module):
    """(observations (B, D), first (B, D)) -> actions (B, V, A) of V prompts."""

    def __init__(self, features: Features, width: int, voices: int, size: int, seed: int) -> None:
        super().__init__()
        self.features, self.voices, self.size = features, voices, size
        with layers_from(seed):
            self.net = nn.Sequential(
                nn.Linear(width, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, HIDDEN), nn.ReLU(),
                nn.Linear(HIDDEN, voices * size),
            )  # fmt: skip

    def forward(self, observations: Tensor, first: Tensor) -> Tensor:
        nothing = observations.new_zeros(len(observations), 0)
        found: Tensor = self.net(self.features.inputs(observations, first, nothing))
        return found.reshape(-1, self.voices, self.size)


def teach(
    features: Features, lived: Lived, wished: Tensor, updates: int, seed: int,
    begun: Echo | None = None,
) -> Echo:  # fmt: skip
    """An echo of `wished` (T, V, A); a function of these and the seed.

    Args:
        begun: the echo that it goes on from, which stays as it is.
    """
    steps = lived.as_steps()
    nothing = steps.actions[:, :0]
    inputs = features.inputs(steps.observations, steps.first, nothing)
    if begun is None:
        echo = Echo(features, inputs.shape[1], wished.shape[1], wished.shape[2], seed)
    else:
        echo = copy.deepcopy(begun)
    optimizer = torch.optim.Adam(echo.parameters(), lr=LR)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, updates)
    target = wished.flatten(1)
    for update in range(updates):
        pick = torch.from_numpy(generator_at(seed, update).integers(len(inputs), size=BATCH))
        loss = (echo.net(inputs[pick]) - target[pick]).square().mean()
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        schedule.step()
    return echo
