"""A policy acting step by step: it builds the windows of training out of what it lives through.

Axes: B rows acting at once, P prompts, K steps of context, D observation, A action.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mpdt.errors import ShapeError, SpecError
from mpdt.model.policy import PolicyBatch, PromptPolicy
from mpdt.model.returns import ReturnTable

Array = NDArray[Any]


@dataclass
class _Step:
    """One step of all rows; the action is filled in once it is known."""

    observations: Array
    previous_actions: Array
    returns_to_go: Array
    timestep: int
    actions: Array


class ClosedLoop:
    """B rows acting at once, each behind the soft prompt of its task.

    The prompts run once, here; afterwards only the window of the last K steps moves. Equal to
    `PromptPolicy.forward` on the same histories, so training and evaluation see the same tokens.
    No gradients.
    """

    def __init__(
        self,
        policy: PromptPolicy,
        prompts: Tensor | None,
        prompt_index: Tensor,
        context: int,
        returns: ReturnTable | None = None,
        action_low: float = -1.0,
        action_high: float = 1.0,
    ) -> None:
        """Prompts (P, l, s); prompt_index (B,) int picks one per row; returns has P rows.

        Actions are clipped to the box before they are returned and remembered: the data show
        executed actions, never wished-for ones.
        """
        self.policy, self.context = policy, context
        self.num_rows = int(prompt_index.shape[0])
        self._low, self._high = action_low, action_high
        for table in (prompts, returns):
            if table is not None and int(prompt_index.max()) >= len(table):
                raise ShapeError(
                    "a row asks for a prompt that is not there",
                    where="ClosedLoop",
                    expected=f"indices below {len(table)}",
                    found=str(int(prompt_index.max())),
                )
        self._returns = None if returns is None else returns.select(prompt_index)
        with torch.no_grad():
            self._prefix = policy.backbone.encode_prefix(prompts).select(prompt_index)
        self.reset()

    def reset(self, targets: Array | None = None) -> None:
        """Forget the histories. targets (B,) raw returns; None takes `returns.target`."""
        if targets is not None and self._returns is None:
            raise SpecError("targets without a table of returns", where="ClosedLoop.reset")
        if targets is None:
            table = self._returns
            targets = np.zeros(self.num_rows) if table is None else table.target.numpy()
        self._check(targets, (self.num_rows,), "targets")
        # Lowered in float64: 500 float32 subtractions would drift from the stored returns.
        self._return_to_go = np.array(targets, dtype=np.float64)
        self._window: deque[_Step] = deque(maxlen=self.context)
        self._timestep = 0

    def act(self, observations: Array, previous_rewards: Array | None = None) -> Array:
        """Actions (B, A) float32 for observations (B, D).

        previous_rewards (B,): what the action before earned; it lowers the return-to-go.
        None at the first step, or to keep the return-to-go constant.
        """
        B, A = self.num_rows, self.policy.action_size
        self._check(observations, (B, self.policy.observation_size), "observations")
        if previous_rewards is not None:
            self._check(previous_rewards, (B,), "previous rewards")
            if not self._window:
                raise SpecError("nothing was earned before the first step", where="ClosedLoop.act")
            self._return_to_go = self._return_to_go - previous_rewards
        nothing = np.zeros((B, A), dtype=np.float32)
        self._window.append(
            _Step(
                np.asarray(observations, dtype=np.float32),
                self._window[-1].actions if self._window else nothing,
                self._return_to_go.astype(np.float32),
                self._timestep,
                nothing,
            )
        )
        self._timestep += 1
        # All rows are equally old, so the window needs no pads before it is full.
        with torch.no_grad():
            wished = self.policy.predict(self._prefix, self._batch(), self._returns)[:, -1]
        actions: Array = wished.numpy().clip(self._low, self._high)
        self._window[-1].actions = actions
        return actions

    def _batch(self) -> PolicyBatch:
        """The window as (n = B, M = 1, K', ...), K' <= K steps so far."""

        def stack(name: str) -> Tensor:
            columns = [getattr(step, name) for step in self._window]
            return torch.from_numpy(np.stack(columns, axis=1)[:, None])

        steps = torch.tensor([step.timestep for step in self._window])
        shape = (self.num_rows, 1, len(self._window))
        return PolicyBatch(
            observations=stack("observations"),
            previous_actions=stack("previous_actions"),
            returns_to_go=stack("returns_to_go"),
            timesteps=steps.expand(shape),
            mask=torch.ones(shape, dtype=torch.bool),
            actions=stack("actions"),
        )

    def _check(self, array: Array, shape: tuple[int, ...], what: str) -> None:
        if np.shape(array) != shape:
            raise ShapeError(
                f"{what} of a closed loop",
                where="ClosedLoop",
                expected=str(shape),
                found=str(np.shape(array)),
            )
