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
from einops import rearrange, repeat
from torch import Tensor, nn

from mpdt.errors import BackboneError, ShapeError

STD_FLOOR = 1e-6  # Prompt-DT's; keeps columns that never move from dividing by zero


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


class InputMap(nn.Module):
    """Turns windows into tokens (n, M, K * tokens_per_step, s).

    Args:
        word_embeddings: (V, s) table of the backbone.
        observation_mean, observation_std: (D,) statistics of the *training* tasks.
        seed: for random starts; nothing touches the global generator.
    """

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
        raise NotImplementedError

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
        raise NotImplementedError


def choose_rows(word_embeddings: Tensor, num: int) -> Tensor:
    """Ids (num,) of words whose centred embeddings are linearly independent.

    Evenly spaced over the vocabulary; a word close to the mean, or to the span of those
    already chosen, is passed over for the next one. Depends on the table alone.
    Raises: BackboneError if the table has no `num` such rows.
    """
    raise NotImplementedError
