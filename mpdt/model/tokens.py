"""Numbers -> tokens: (return-to-go, observation, previous action) enter a language model.

Axes: n tasks, M windows, K steps, D observation, A action, F inputs, s width, V vocabulary.

    one token per step     x_t = [R_t, (missing), s_t, a_{t-1}]  ->  token_t  ->  predicts a_t
    three per step         R_t, s_t, a_t  ->  three tokens; the middle one predicts a_t

The frozen map has actual word embeddings of the backbone as rows, one per input, so a token is
the mean word plus a mixture of words; it never leaves what the model was pretrained on.
"""

from __future__ import annotations

from typing import Literal

import msgspec
import torch
import torch.nn.functional as F
from einops import rearrange
from torch import Tensor, nn

from mpdt.errors import (
    BackboneError,
    ShapeError,
    SpecError,
    UsageError,
    check_above_zero,
    check_at_least,
)
from mpdt.seeding import layers_from, torch_generator

STD_FLOOR = 1e-6  # Prompt-DT's; keeps columns that never move from dividing by zero
_MIN_RESIDUAL = 0.25  # share of a row's norm outside the span of the rows before it


class InputSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the policy sees of a step and how it becomes tokens."""

    kind: Literal["frozen", "trained", "mlp"] = "frozen"
    """frozen: word-embedding rows. trained: the same start, learned. mlp: a residual block more."""
    start: Literal["words", "random"] = "words"
    """Rows the map starts from: words of the backbone, or Gaussian ones of the same norm."""
    scale: float = 1.0
    """Size of a token around the mean word, as a multiple of a real word's distance from it."""
    return_to_go: Literal["none", "family", "task"] = "task"
    """Leave it out, or which scale and target it uses (see `ReturnTable`)."""
    return_clip: bool = True
    """Keep the return-to-go inside the range of the training data."""
    return_dropout: float = 0.0
    """Chance that a training window does not see its return-to-go; adds a 'missing' input."""
    previous_action: bool = True
    """Show a_{t-1} (three tokens per step: a_t, after the token that predicts it)."""
    observation_clip: float = 10.0
    """Standardised observations are cut at +- this; 0 never cuts."""
    time_table: int = 1000
    """Rows of the trained time-step table, at least the horizon; 0 leaves it out."""
    tokens_per_step: Literal[1, 3] = 1

    def __post_init__(self) -> None:
        check_at_least("inputs.time_table", self.time_table, 0)
        check_at_least("inputs.observation_clip", self.observation_clip, 0)
        check_above_zero("inputs.scale", self.scale)
        if not 0 <= self.return_dropout < 1:
            raise UsageError(
                "setting out of range", where="inputs.return_dropout",
                expected="at least 0 and below 1", found=str(self.return_dropout),
                hint="to never show a return-to-go: --inputs.return-to-go none",
            )  # fmt: skip


class InputMap(nn.Module):
    """Turns windows into tokens (n, M, K * tokens_per_step, s).

    Args:
        word_embeddings: (V, s) table of the backbone; V = 0 starts from zeros, to be filled.
        observation_mean, observation_std: (D,) statistics of the *training* tasks.
        seed: for random starts; nothing touches the global generator.
    """

    mean: Tensor
    std: Tensor

    def __init__(
        self,
        settings: InputSettings,
        observation_size: int,
        action_size: int,
        word_embeddings: Tensor,
        observation_mean: Tensor,
        observation_std: Tensor,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.settings = settings
        wants_return = settings.return_to_go != "none"
        self.sees_missing = wants_return and settings.return_dropout > 0
        num_return = int(wants_return) + int(self.sees_missing)
        num_action = action_size if settings.previous_action else 0
        groups = [num_return, observation_size, num_action]
        if settings.tokens_per_step == 1:
            groups = [sum(groups)]
        self.register_buffer("mean", observation_mean.to(torch.float32))
        self.register_buffer("std", observation_std.to(torch.float32).clamp(min=STD_FLOOR))
        rows, centre = word_rows(settings, word_embeddings, sum(groups), seed)
        self.maps = nn.ModuleList(
            TokenMap(settings, part, centre, seed) for part in torch.split_with_sizes(rows, groups)
        )
        self.time = None
        if settings.time_table:
            # From zero: tokens start as words, and steps never visited stay without a say.
            self.time = nn.Parameter(torch.zeros(settings.time_table, word_embeddings.shape[1]))

    def forward(
        self,
        observations: Tensor,
        previous_actions: Tensor,
        returns_to_go: Tensor | None,
        timesteps: Tensor,
        mask: Tensor,
        actions: Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> Tensor:
        """Tokens of windows.

        Args:
            observations: (n, M, K, D) raw.
            previous_actions: (n, M, K, A), 0 before the first step.
            returns_to_go: (n, M, K) already normalised; None = not known in this batch.
            timesteps: (n, M, K) int, 0 at pads.
            mask: (n, M, K) bool; whatever stands at pads is replaced by zeros.
            actions: (n, M, K, A), read only with three tokens per step (None = zeros).
            generator: hand one in to apply `return_dropout`; without it nothing is dropped.
        """
        settings = self.settings
        seen = self._returns(returns_to_go, mask, generator)
        states = (observations - self.mean) / self.std
        if settings.observation_clip > 0:
            states = states.clamp(-settings.observation_clip, settings.observation_clip)
        one = settings.tokens_per_step == 1
        shown = previous_actions if one else actions
        if not settings.previous_action:
            shown = states[..., :0]
        elif shown is None:
            shown = torch.zeros_like(previous_actions)
        groups = [seen, states, shown]
        if one:
            groups = [torch.cat(groups, dim=-1)]
        # Replaced, not multiplied: a NaN at a pad must not get through.
        tokens = [
            tokens_of(group.masked_fill(~mask[..., None], 0.0))
            for tokens_of, group in zip(self.maps, groups, strict=True)
        ]
        if self.time is not None:
            self._check_timesteps(timesteps)
            times = F.embedding(timesteps.masked_fill(~mask, 0), self.time)
            tokens = [token + times for token in tokens]
        windows: Tensor = rearrange(tokens, "q n M K s -> n M (K q) s")
        return windows

    def _returns(
        self, returns_to_go: Tensor | None, mask: Tensor, generator: torch.Generator | None
    ) -> Tensor:
        """The return columns (n, M, K, 0 to 2): value, and whether it is missing."""
        settings = self.settings
        empty = torch.zeros((*mask.shape, 0), device=mask.device)
        if settings.return_to_go == "none":
            return empty
        if returns_to_go is None and not self.sees_missing:
            raise SpecError(
                "this policy was built to see a return-to-go and got none",
                where=f"return_to_go {settings.return_to_go}",
                hint="hand in the returns, or train with return_dropout above 0",
            )
        missing = torch.zeros(mask.shape[:2], dtype=torch.bool, device=mask.device)
        if returns_to_go is None:
            returns_to_go, missing = torch.zeros(mask.shape, device=mask.device), ~missing
        elif self.sees_missing and generator is not None:
            # Drawn on the processor: the same numbers on every device.
            drawn = torch.rand(missing.shape, generator=generator).to(mask.device)
            missing = drawn < settings.return_dropout
        missing = missing[..., None].expand(mask.shape)
        columns = [returns_to_go.masked_fill(missing, 0.0)]
        if self.sees_missing:
            columns.append(missing.to(torch.float32))
        return torch.stack(columns, dim=-1)

    def _check_timesteps(self, timesteps: Tensor) -> None:
        last = int(timesteps.max())
        if last >= self.settings.time_table:
            raise ShapeError(
                "an episode is longer than the time-step table",
                where="InputMap",
                expected=f"steps below {self.settings.time_table}",
                found=str(last),
                hint="raise time_table, or set it to 0",
            )


class TokenMap(nn.Module):
    """Inputs (..., F) -> tokens (..., s): centre + x @ rows, and for `mlp` a residual block."""

    def __init__(self, settings: InputSettings, rows: Tensor, centre: Tensor, seed: int) -> None:
        super().__init__()
        learned = settings.kind != "frozen"
        # Every input of unit variance adds |row|^2 to the expected squared norm of a token.
        rows = rows / max(rows.shape[0], 1) ** 0.5
        self.rows = nn.Parameter(rows.clone(), requires_grad=learned)
        self.centre = nn.Parameter(centre.clone(), requires_grad=learned)
        self.block: nn.Module | None = None
        if settings.kind == "mlp":
            # LaMo (Shi et al. 2023), ResidualBlock: skip(x) + fc2(gelu(fc1(x))). fc2 from zero,
            # so that it starts where the other kinds do.
            width = rows.shape[1]
            with layers_from(seed):
                last = nn.Linear(width, width)
                self.block = nn.Sequential(nn.Linear(rows.shape[0], width), nn.GELU(), last)
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)

    def forward(self, x: Tensor) -> Tensor:
        tokens = self.centre + x @ self.rows
        return tokens if self.block is None else tokens + self.block(x)


def word_rows(
    settings: InputSettings, word_embeddings: Tensor, num: int, seed: int
) -> tuple[Tensor, Tensor]:
    """Rows (num, s), all of one norm, and the mean word (s,) they are added to.

    The norm is `scale` times the root mean square distance of a word from the mean word.
    """
    if not len(word_embeddings):
        return word_embeddings.new_zeros(num, word_embeddings.shape[1]), word_embeddings.sum(dim=0)
    centre = word_embeddings.mean(dim=0)
    size = (word_embeddings - centre).square().sum(dim=1).mean().sqrt()
    if settings.start == "words":
        rows = word_embeddings[choose_rows(word_embeddings, num)] - centre
    else:
        generator = torch_generator(seed)
        rows = torch.randn((num, word_embeddings.shape[1]), generator=generator)
    return settings.scale * size * rows / rows.norm(dim=1, keepdim=True), centre


def choose_rows(word_embeddings: Tensor, num: int) -> Tensor:
    """Ids (num,) of words whose centred embeddings are linearly independent.

    Evenly spaced over the vocabulary; a word close to the mean, or to the span of those
    already chosen, is passed over for the next one. Depends on the table alone.
    Raises: BackboneError if the table has no `num` such rows.
    """
    centred = word_embeddings - word_embeddings.mean(dim=0)
    norms = centred.norm(dim=1)
    usable = (norms > 0.1 * norms.median()).tolist()
    size = len(usable)
    chosen: list[int] = []
    basis = torch.zeros((0, centred.shape[1]), dtype=torch.float64)
    for place in range(num):
        for step in range(size):
            row = (place * size // num + step) % size
            if not usable[row]:
                continue
            unit = centred[row].double() / norms[row]
            rest = unit - basis.T @ (basis @ unit)
            if float(rest.norm()) > _MIN_RESIDUAL:
                chosen.append(row)
                basis = torch.cat([basis, (rest / rest.norm())[None]])
                break
        else:
            raise BackboneError(
                "the word embeddings cannot carry that many inputs apart",
                where="choose_rows",
                expected=f"{num} independent rows of width {centred.shape[1]}",
                found=str(len(chosen)),
                hint="take a wider backbone",
            )
    return torch.tensor(chosen, dtype=torch.long)
