"""Search for actions inside the world model: the cross-entropy method in knots.

    round 1   samples around the plan of before  +  what the trained prompts' echo would do
    round 2   samples around the best of these
    done      the first `knot` actions of the best sequence of all, then everything anew

A sequence is `horizon` steps; a sample's action changes every `knot` steps. Echoes answer at every
step, so the best of theirs is done as it was imagined.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mpdt.train.adapt.trials.settings import PlannerSettings

WorldStep = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]
"""(observations (B, D), first (B, D), actions (B, A)) -> (next observations, rewards (B,))."""
Voices = Callable[[Tensor, Tensor], Tensor]
"""(observations (B, D), first (B, D)) -> actions (B, V, A)."""


@dataclass(frozen=True)
class Imagined:
    """B roll-outs inside the model: actions (B, H, A) in the box, discounted returns (B,)."""

    actions: Tensor
    returns: Tensor


@torch.no_grad()
def imagine(
    world: WorldStep, observation: Tensor, first: Tensor, actions: Tensor, discount: float,
    low: float, high: float, voices: Voices | None = None, own: Tensor | None = None,
) -> Imagined:  # fmt: skip
    """Let sequences run from one observation (D,), all side by side.

    Args:
        first: (D,) observation that the episode began with.
        actions: (B, H, A); of the last rows, where there are voices, what is added to theirs.
        own: (P,) which voice each of the last P rows listens to.
    """
    B, H, _ = actions.shape
    now, begun = observation.expand(B, -1), first.expand(B, -1)
    done, earned, weight = actions.clone(), torch.zeros(B), 1.0
    rows = None if own is None else torch.arange(len(own))
    for step in range(H):
        if voices is not None and own is not None and len(own):
            at = B - len(own)
            done[at:, step] += voices(now[at:], begun[at:])[rows, own]
        done[:, step].clamp_(low, high)
        now, rewards = world(now, begun, done[:, step])
        earned += weight * rewards
        weight *= discount
    return Imagined(done, earned)


class Planner:
    """Plans one episode.

    Args:
        num_voices: V.
        generator: every random number comes from it, in the order of the steps.
        probes: whether now and then a corner of the action box is held for a few steps.
    """

    def __init__(
        self, world: WorldStep, voices: Voices | None, num_voices: int, action_size: int,
        low: float, high: float, settings: PlannerSettings, generator: np.random.Generator,
        probes: bool = False,
    ) -> None:  # fmt: skip
        self.world, self._voices, self._settings = world, voices, settings
        self.action_size, self._low, self._high = action_size, low, high
        self._half = (high - low) / 2
        self._generator = generator
        self._knots = -(-settings.horizon // settings.knot)
        self._mean = torch.zeros(self._knots, action_size)
        echoes = settings.echoes if voices is not None else 0
        self._own = torch.arange(num_voices).repeat(echoes)
        self._quiet = num_voices if echoes else 0
        self._left: list[np.ndarray] = []
        self._probes, self._steps = probes, 0

    def act(self, observation: np.ndarray, first: np.ndarray) -> np.ndarray:
        """The action (A,) of this step; plans anew where the plan is used up."""
        settings = self._settings
        self._steps += 1
        if self._probes and self._steps % settings.probe_every == 0:
            corner = np.where(self._generator.random(self.action_size) < 0.5, self._low, self._high)
            self._left = [corner.astype(np.float32)] * settings.probe
        if not self._left:
            best = self.plan(torch.from_numpy(observation), torch.from_numpy(first))
            self._left = list(best[: settings.knot].numpy())
        noise = self._generator.standard_normal(self.action_size) * settings.noise * self._half
        action: np.ndarray = (self._left.pop(0) + noise).clip(self._low, self._high)
        return action.astype(np.float32)

    def plan(self, observation: Tensor, first: Tensor) -> Tensor:
        """The best sequence found (H, A)."""
        settings, knot = self._settings, self._settings.knot
        horizon = self._knots * knot
        mean, std = self._mean, torch.full_like(self._mean, settings.spread * self._half)
        best, most = mean.repeat_interleave(knot, dim=0), -float("inf")
        for number in range(settings.rounds):
            knots = mean + std * self._normal(settings.samples, self._knots, self.action_size)
            knots[0] = mean
            own = None
            if number == 0 and len(self._own):
                shy = settings.spread * self._half / 2
                added = shy * self._normal(len(self._own), self._knots, self.action_size)
                added[: self._quiet] = 0
                knots, own = torch.cat([knots, added]), self._own
            found = imagine(
                self.world, observation, first, knots.repeat_interleave(knot, dim=1),
                settings.discount, self._low, self._high, self._voices if own is not None else None,
                own,
            )  # fmt: skip
            order = found.returns.argsort(descending=True, stable=True)
            if float(found.returns[order[0]]) > most:
                most, best = float(found.returns[order[0]]), found.actions[order[0]]
            chosen = found.actions[order[: settings.elites]]
            chosen = chosen.reshape(len(chosen), self._knots, knot, -1).mean(dim=2)
            mean = chosen.mean(dim=0)
            std = chosen.std(dim=0, correction=0).clamp_min(0.05 * self._half)
        after = best.reshape(self._knots, knot, -1).mean(dim=1)
        self._mean = torch.cat([after[1:], after[-1:]])
        assert len(best) == horizon
        return best

    def _normal(self, *shape: int) -> Tensor:
        return torch.from_numpy(self._generator.standard_normal(shape, dtype=np.float32))
