"""The policy: windows behind soft prompts in, actions out.

Axes: n tasks, M windows, K steps, D observation, A action, l prompt length, s width, B rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import msgspec
import numpy as np
import torch
from einops import repeat
from numpy.typing import NDArray
from torch import Tensor, nn

from mpdt.errors import check_at_least
from mpdt.model.backbone import Backbone
from mpdt.model.returns import ReturnTable
from mpdt.model.tokens import InputMap, InputSettings
from mpdt.model.weights import check_shapes
from mpdt.seeding import layers_from


class HeadSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """LayerNorm -> Linear(width, hidden) -> GELU -> Linear(hidden, A) -> tanh."""

    hidden: int | None = None
    """None: as wide as the backbone. 0: one linear layer."""
    layer_norm: bool = True
    affine: bool = False
    """Trained gain and bias of the LayerNorm."""
    tanh: bool = False
    """Bounds the output; targets beyond +-1 can then not be reached."""

    def __post_init__(self) -> None:
        if self.hidden is not None:
            check_at_least("head.hidden", self.hidden, 0)


class Windows(Protocol):
    """What a sampler hands over: numpy arrays (n, M, K, ...), read and never set."""

    @property
    def observations(self) -> NDArray[Any]: ...
    @property
    def previous_actions(self) -> NDArray[Any]: ...
    @property
    def actions(self) -> NDArray[Any]: ...
    @property
    def returns_to_go(self) -> NDArray[Any]: ...
    @property
    def timesteps(self) -> NDArray[Any]: ...
    @property
    def mask(self) -> NDArray[Any]: ...


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

        def tensor(array: NDArray[Any]) -> Tensor:
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
        observation_mean: NDArray[Any],
        observation_std: NDArray[Any],
        action_size: int,
        seed: int = 0,
    ) -> None:
        """Statistics (D,) must come from training tasks only. `seed` starts map and head."""
        super().__init__()
        self.backbone = backbone
        self.observation_size, self.action_size = len(observation_mean), action_size
        self.inputs = InputMap(
            inputs,
            self.observation_size,
            action_size,
            backbone.word_embeddings,
            torch.from_numpy(np.asarray(observation_mean, dtype=np.float32)),
            torch.from_numpy(np.asarray(observation_std, dtype=np.float32)),
            seed,
        )
        self.head = _build_head(head, backbone.width, action_size, seed)

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
        tokens, mask = self.tokens(batch, returns, generator)
        hidden, features = self.backbone(prompts, tokens, mask, layer_features)
        return PolicyOutput(
            self.head(self._predicting(hidden)),
            tuple(self._predicting(feature) for feature in features),
        )

    def own_state(self) -> dict[str, Tensor]:
        """Trainables and the buffers they were trained with; of a backbone only what is trained."""
        trained = {name for name, value in self.named_parameters() if value.requires_grad}
        return {
            name: value
            for name, value in self.state_dict().items()
            if name in trained or not name.startswith("backbone.")
        }

    def load_own_state(self, state: dict[str, Tensor]) -> None:
        """Undo `own_state`. Raises: ShapeError for missing, unknown or misshapen tensors."""
        own = self.own_state()
        check_shapes({k: tuple(v.shape) for k, v in own.items()}, state, "PromptPolicy")
        self.load_state_dict(state, strict=False)

    def tokens(
        self,
        batch: PolicyBatch,
        returns: ReturnTable | None = None,
        generator: torch.Generator | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Tokens (n, M, K q, s) and their mask (n, M, K q), q tokens per step."""
        return embed(self.inputs, batch, returns, generator)

    def _predicting(self, x: Tensor) -> Tensor:
        """The tokens that predict an action: all, or the middle one of three."""
        return x if self.inputs.settings.tokens_per_step == 1 else x[:, :, 1::3]


def embed(
    inputs: InputMap,
    batch: PolicyBatch,
    returns: ReturnTable | None = None,
    generator: torch.Generator | None = None,
) -> tuple[Tensor, Tensor]:
    """Tokens (n, M, K q, s) of a batch and their mask (n, M, K q), q tokens per step."""
    settings, seen = inputs.settings, None
    if returns is not None and settings.return_to_go != "none":
        seen = returns.normalise(batch.returns_to_go, settings.return_clip)
    tokens = inputs(
        batch.observations, batch.previous_actions, seen, batch.timesteps, batch.mask,
        batch.actions, generator,
    )  # fmt: skip
    return tokens, repeat(batch.mask, "n M K -> n M (K q)", q=settings.tokens_per_step)


def _build_head(settings: HeadSettings, width: int, action_size: int, seed: int) -> nn.Sequential:
    hidden = width if settings.hidden is None else settings.hidden
    layers: list[nn.Module] = []
    if settings.layer_norm:
        layers.append(nn.LayerNorm(width, elementwise_affine=settings.affine))
    with layers_from(seed):
        if hidden:
            layers += [nn.Linear(width, hidden), nn.GELU()]
        layers.append(nn.Linear(hidden or width, action_size))
    if settings.tanh:
        layers.append(nn.Tanh())
    return nn.Sequential(*layers)


def action_loss(predicted: Tensor, actions: Tensor, mask: Tensor) -> Tensor:
    """Mean squared error per action component over real steps.

    predicted, actions (n, M, K, A), mask (n, M, K). Pads count neither above nor below the line.
    Source: Chen et al. 2021; Xu et al. 2022.
    """
    squared = (predicted - actions).square().mean(dim=-1)
    return squared.masked_fill(~mask, 0.0).sum() / mask.sum()
