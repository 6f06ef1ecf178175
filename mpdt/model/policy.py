"""The policy: windows behind soft prompts in, actions out; and its closed loop.

Axes: n tasks, M windows, K steps, D observation, A action, l prompt length, s width, B rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import msgspec
import numpy as np
import torch
from torch import Tensor, nn

from mpdt.model.backbone import Backbone
from mpdt.model.returns import ReturnTable
from mpdt.model.tokens import InputMap, InputSettings


class HeadSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """LayerNorm -> Linear(width, hidden) -> GELU -> Linear(hidden, A) -> tanh."""

    hidden: int | None = None
    """None: as wide as the backbone. 0: one linear layer."""
    layer_norm: bool = True
    affine: bool = False
    """Trained gain and bias of the LayerNorm."""
    tanh: bool = False
    """Bounds the output; targets beyond +-1 can then not be reached."""


class Windows(Protocol):
    """What a sampler hands over: numpy arrays (n, M, K, ...)."""

    observations: np.ndarray
    previous_actions: np.ndarray
    actions: np.ndarray
    returns_to_go: np.ndarray
    timesteps: np.ndarray
    mask: np.ndarray


@dataclass(frozen=True)
class PolicyBatch:
    """Windows as tensors. Units as in the data: raw observations, raw returns.

    observations (n, M, K, D) f4, previous_actions (n, M, K, A) f4, returns_to_go (n, M, K) f4,
    timesteps (n, M, K) i8, mask (n, M, K) bool, actions (n, M, K, A) f4 or None (closed loop).
    """

    observations: Tensor
    previous_actions: Tensor
    returns_to_go: Tensor
    timesteps: Tensor
    mask: Tensor
    actions: Tensor | None = None

    @classmethod
    def from_windows(cls, windows: Windows) -> PolicyBatch:
        """The same windows as tensors that share the arrays' memory where they can."""

        def tensor(array: np.ndarray) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(array))

        return cls(
            observations=tensor(windows.observations),
            previous_actions=tensor(windows.previous_actions),
            returns_to_go=tensor(windows.returns_to_go),
            timesteps=tensor(windows.timesteps),
            mask=tensor(windows.mask),
            actions=tensor(windows.actions),
        )


@dataclass(frozen=True)
class PolicyOutput:
    """actions (n, M, K, A); features: L tensors (n, M, K, s), empty unless asked for."""

    actions: Tensor
    features: tuple[Tensor, ...]


class PromptPolicy(nn.Module):
    """Backbone, input map and action head. Soft prompts live outside and are handed in.

    Trainables: those of `inputs` (time table, map unless frozen) and of `head`.
    """

    def __init__(
        self,
        backbone: Backbone,
        inputs: InputSettings,
        head: HeadSettings,
        observation_mean: np.ndarray,
        observation_std: np.ndarray,
        action_size: int,
        seed: int = 0,
    ) -> None:
        """Statistics (D,) must come from training tasks only. `seed` starts map and head."""
        super().__init__()
        raise NotImplementedError

    def forward(
        self,
        batch: PolicyBatch,
        prompts: Tensor | None,
        returns: ReturnTable | None = None,
        *,
        generator: torch.Generator | None = None,
        layer_features: bool = False,
    ) -> PolicyOutput:
        """Predicted actions for every step of every window.

        Args:
            prompts: (n, l, s), or None for policies without a prompt.
            returns: n rows, one per task; None = the return-to-go is not known (needs
                `return_to_go` "none" or `return_dropout` > 0).
            generator: hand one in while training, to apply `return_dropout`.
            layer_features: also return the output of every block where actions are predicted.
        """
        raise NotImplementedError

    def own_state(self) -> dict[str, Tensor]:
        """Everything but a frozen backbone: trainables and the buffers they were trained with."""
        raise NotImplementedError

    def load_own_state(self, state: dict[str, Tensor]) -> None:
        """Undo `own_state`. Raises: ShapeError for missing, unknown or misshapen tensors."""
        raise NotImplementedError


def action_loss(predicted: Tensor, actions: Tensor, mask: Tensor) -> Tensor:
    """Mean squared error per action component over real steps (FACTS: L_act)."""
    raise NotImplementedError


class ClosedLoop:
    """B rows acting at once, each behind the soft prompt of its task.

    The prompts run once, here; afterwards only the window of the last K steps moves. Equal to
    `PromptPolicy.forward` on the same histories. No gradients.
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

        Actions are clipped to the box before they are returned and remembered.
        """
        raise NotImplementedError

    def reset(self, targets: np.ndarray | None = None) -> None:
        """Forget the histories. targets (B,) raw returns; None takes `returns.target`."""
        raise NotImplementedError

    def act(
        self, observations: np.ndarray, previous_rewards: np.ndarray | None = None
    ) -> np.ndarray:
        """Actions (B, A) float32 for observations (B, D).

        previous_rewards (B,): what the action before earned; it lowers the return-to-go.
        None at the first step, or to keep the return-to-go constant.
        """
        raise NotImplementedError
