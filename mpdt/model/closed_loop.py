"""A policy acting step by step: it sees the windows of training, made of what it lives through.

Axes: B rows acting at once, P prompts, K steps of context, D observation, A action, q tokens a
step.

    (R_t, s_t, a_{t-1}) -> new tokens -> window of K steps -> hidden of the newest -> action
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mpdt.errors import ShapeError, SpecError
from mpdt.model.blocks import filled, in_company
from mpdt.model.moving_window import MovingWindow, prompt_prefix
from mpdt.model.policy import PolicyBatch, PromptPolicy
from mpdt.model.returns import ReturnTable

Array = NDArray[Any]

FEW_ROWS = 16
"""Up to so many rows act on one thread: waking others costs more than they do, and on a busy
machine many times more."""


@dataclass(frozen=True)
class _Step:
    """One step of all rows."""

    observations: Array
    previous_actions: Array
    returns_to_go: Array
    timesteps: Array
    real: Array
    """(B,) bool: it belongs to the row's present episode."""
    actions: Array
    """Nothing (zeros) until they are chosen."""


class ClosedLoop:
    """B rows acting at once, each behind the soft prompt of its task.

    The prompts run once, here; afterwards each step costs about one token (`MovingWindow`).
    Equal to `PromptPolicy.forward` on the same histories, so training and evaluation see the
    same tokens. No gradients. torch's threads are left as they were.
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
        # Few rows are filled up with copies where products of few rows would round differently.
        self._filled = filled(self.num_rows)
        self._low, self._high = action_low, action_high
        for table in (prompts, returns):
            if table is not None and int(prompt_index.max()) >= len(table):
                raise ShapeError(
                    "a row asks for a prompt that is not there",
                    where="ClosedLoop",
                    expected=f"indices below {len(table)}",
                    found=str(int(prompt_index.max())),
                )
        self._returns = None if returns is None else returns.select(prompt_index[self._filled])
        self._step_tokens = policy.inputs.settings.tokens_per_step
        # Of three tokens of a step the last is its action, which nobody knows while it is chosen.
        self._asked = self._step_tokens // 2 + 1
        most = context * self._step_tokens - (self._step_tokens - self._asked)
        with torch.no_grad():
            # Those that somebody stands behind, each once.
            own, place = torch.unique(prompt_index, return_inverse=True)
            used = None if prompts is None else prompts[own]
            prefix = prompt_prefix(policy.backbone, used).select(place)
        self._window = MovingWindow(policy.backbone, prefix, self.num_rows, most)
        self.reset()

    def reset(self, targets: Array | None = None) -> None:
        """Forget the histories. targets (B,) raw returns; None takes `returns.target`."""
        if targets is not None and self._returns is None:
            raise SpecError("targets without a table of returns", where="ClosedLoop.reset")
        if targets is None:
            table = self._returns
            targets = np.zeros(self.num_rows) if table is None else table.target.numpy()
            targets = targets[: self.num_rows]
        self._check(targets, (self.num_rows,), "targets")
        # Lowered in float64: 500 float32 subtractions would drift from the stored returns.
        self._targets: Array = np.array(targets, dtype=np.float64)
        self._return_to_go = self._targets
        self._last: _Step | None = None

    def ask(self, targets: Array) -> None:
        """Raw returns (B,) to be asked of the episodes that begin from now on."""
        self._check(targets, (self.num_rows,), "targets")
        self._targets = np.array(targets, dtype=np.float64)

    def acted(self, actions: Array) -> None:
        """What (B, A) was done at the last step in place of the actions that were chosen."""
        self._check(actions, (self.num_rows, self.policy.action_size), "actions")
        assert self._last is not None, "act() comes first"
        done = np.asarray(actions, np.float32).clip(self._low, self._high)
        self._last = replace(self._last, actions=done)

    def fork(self) -> ClosedLoop:
        """Another loop with the same histories; neither knows what the other does from now on."""
        other = copy.copy(self)
        other._window = self._window.fork()
        return other

    def act(
        self,
        observations: Array,
        previous_rewards: Array | None = None,
        starts: Array | None = None,
    ) -> Array:
        """Actions (B, A) float32 for observations (B, D).

        Args:
            previous_rewards: (B,) what the action before earned; it lowers the return-to-go.
                None at the first step, or to keep the return-to-go constant.
            starts: (B,) bool, rows whose episode begins with these observations: they forget
                the one before, and nothing was earned. None: all at the first step, then none.
        """
        B = self.num_rows
        self._check(observations, (B, self.policy.observation_size), "observations")
        if previous_rewards is not None:
            self._check(previous_rewards, (B,), "previous rewards")
            if self._last is None and starts is None:
                raise SpecError("nothing was earned before the first step", where="ClosedLoop.act")
        begins = np.full(B, self._last is None)
        if starts is not None:
            self._check(starts, (B,), "starts")
            begins |= np.asarray(starts, dtype=np.bool_)
        rewards = np.zeros(B) if previous_rewards is None else np.asarray(previous_rewards)
        steps = self._steps(np.array(observations, dtype=np.float32), rewards, begins)
        with torch.inference_mode(), few_threads(B):
            if begins.any():
                self._window.forget(torch.from_numpy(begins))
            batch = _as_batch(steps, self._filled)
            tokens = self.policy.tokens(batch, self._returns)[0][:B, 0]
            tokens = tokens[:, : tokens.shape[1] - (self._step_tokens - self._asked)]
            tokens = tokens[:, -self._step_tokens :]
            # An action that was chosen in another episode, or in none, is no token of this one.
            real = np.where(begins, self._asked, tokens.shape[1])
            hidden = self._window.append(tokens, torch.from_numpy(real))
            wished = in_company(self.policy.head, hidden).numpy()
        actions: Array = wished.clip(self._low, self._high)
        self._last = replace(steps[-1], actions=actions)
        return actions

    def _steps(self, observations: Array, rewards: Array, begins: Array) -> list[_Step]:
        """The step of now, behind the one before where its action is a token of its own."""
        nothing = np.zeros((len(begins), self.policy.action_size), dtype=np.float32)
        last = self._last
        if last is None:
            returns_to_go, timesteps, earlier = self._targets, np.zeros(len(begins), int), nothing
        else:
            returns_to_go = np.where(begins, self._targets, self._return_to_go - rewards)
            timesteps = np.where(begins, 0, last.timesteps + 1)
            earlier = np.where(begins[:, None], 0, last.actions).astype(np.float32)
        self._return_to_go = returns_to_go
        now = _Step(
            observations, earlier, returns_to_go.astype(np.float32), timesteps,
            np.ones(len(begins), np.bool_), nothing,
        )  # fmt: skip
        if last is None or self._step_tokens == 1:
            return [now]
        return [replace(last, real=~begins), now]

    def _check(self, array: Array, shape: tuple[int, ...], what: str) -> None:
        if np.shape(array) != shape:
            raise ShapeError(
                f"{what} of a closed loop",
                where="ClosedLoop",
                expected=str(shape),
                found=str(np.shape(array)),
            )


@contextmanager
def few_threads(rows: int) -> Iterator[None]:
    """One torch thread inside, if the rows are few; afterwards as many as there were."""
    before = torch.get_num_threads()
    if rows > FEW_ROWS or before == 1:
        yield
        return
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _as_batch(steps: list[_Step], rows: Tensor) -> PolicyBatch:
    """Those rows of the steps as windows (n, M = 1, K = 1 or 2, ...)."""

    def stack(name: str) -> Tensor:
        columns = [getattr(step, name) for step in steps]
        return torch.from_numpy(np.stack(columns, axis=1)[:, None])[rows]

    return PolicyBatch(
        observations=stack("observations"),
        previous_actions=stack("previous_actions"),
        returns_to_go=stack("returns_to_go"),
        timesteps=stack("timesteps"),
        mask=stack("real"),
        actions=stack("actions"),
    )
