"""The blocks of a language model in the pieces that acting needs one by one.

Axes: B rows, K tokens, s width, H query heads, G key heads, d head width, l prompt length.

    x ── project ──> queries, keys, values ── turn ──> attend ──> rest(x, attended) ──> x'

The weights and norms are the library's own modules, so whatever is put on them (low-rank
additions) is used here too; only the order of the calls is ours. `Backbone.forward_with_cache`
is the same computation in one piece, and the tests hold the two together.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, Protocol

import torch
import torch.nn.functional as F
from einops import rearrange, repeat
from torch import Tensor

Turn = tuple[Tensor, Tensor]
"""Cosines and sines (1 or B, 1, K, d/2) float32 of the tokens' angles."""


class BlockShape(Protocol):
    """How one architecture's blocks come apart.

    Attributes:
        relative: a position changes only the angle of queries and keys, so that what the first
            block projects from a token stays right wherever the token moves to.
    """

    relative: bool

    def enter(self, tokens: Tensor, positions: Tensor) -> Tensor:
        """What the first block sees of tokens (B, K, s) at positions (1 or B, K)."""
        ...

    def turn(self, positions: Tensor) -> Turn | None:
        """Angles of positions (1 or B, K); None where positions have no angle."""
        ...

    def project(self, block: Any, x: Tensor, newest: bool) -> tuple[Tensor, Tensor, Tensor]:
        """Queries (B, H, K, d), keys and values (B, G, K, d) of x (B, K, s), not yet turned.

        newest: queries of the last token alone (B, H, 1, d).
        """
        ...

    def rest(self, block: Any, x: Tensor, attended: Tensor) -> Tensor:
        """The block's output for tokens x (B, Q, s) that attended to (B, Q, H d)."""
        ...

    def scaling(self, block: Any) -> float:
        """What the products of queries and keys are multiplied by."""
        ...

    def norm(self, x: Tensor) -> Tensor:
        """The final norm."""
        ...


class Rotary:
    """Llama: positions turn queries and keys."""

    relative = True

    def __init__(self, model: Any) -> None:
        self._model = model

    def enter(self, tokens: Tensor, positions: Tensor) -> Tensor:
        return tokens

    def turn(self, positions: Tensor) -> Turn | None:
        # The library's table for these positions: some kinds stretch it with the length. The
        # two halves of a head turn by the same angles, which the table holds twice.
        like = torch.empty(0, dtype=torch.float32)
        cos, sin = self._model.rotary_emb(like, positions)
        half = cos.shape[-1] // 2
        return cos[:, None, :, :half], sin[:, None, :, :half]

    def project(self, block: Any, x: Tensor, newest: bool) -> tuple[Tensor, Tensor, Tensor]:
        own, seen = block.self_attn, block.input_layernorm(x)
        k, v = own.k_proj(seen), own.v_proj(seen)
        q = in_company(own.q_proj, seen[:, -1:]) if newest else own.q_proj(seen)
        return _heads(q, own.head_dim), _heads(k, own.head_dim), _heads(v, own.head_dim)

    def rest(self, block: Any, x: Tensor, attended: Tensor) -> Tensor:
        x = x + block.self_attn.o_proj(attended)
        changed: Tensor = x + block.mlp(block.post_attention_layernorm(x))
        return changed

    def scaling(self, block: Any) -> float:
        return float(block.self_attn.scaling)

    def norm(self, x: Tensor) -> Tensor:
        normed: Tensor = self._model.norm(x)
        return normed


class Learned:
    """GPT-2: a learned vector per position is added to the token."""

    relative = False

    def __init__(self, model: Any) -> None:
        self._model = model

    def enter(self, tokens: Tensor, positions: Tensor) -> Tensor:
        placed: Tensor = tokens + self._model.wpe(positions)
        return placed

    def turn(self, positions: Tensor) -> Turn | None:
        return None

    def project(self, block: Any, x: Tensor, newest: bool) -> tuple[Tensor, Tensor, Tensor]:
        own, seen = block.attn, block.ln_1(x)
        # One matrix (s, 3 s) for all three, side by side.
        weight, bias, width = own.c_attn.weight, own.c_attn.bias, own.split_size

        def ask(x: Tensor) -> Tensor:
            asked: Tensor = x @ weight[:, :width] + bias[:width]
            return asked

        q = in_company(ask, seen[:, -1:]) if newest else ask(seen)
        k, v = (seen @ weight[:, width:] + bias[width:]).chunk(2, dim=-1)
        return _heads(q, own.head_dim), _heads(k, own.head_dim), _heads(v, own.head_dim)

    def rest(self, block: Any, x: Tensor, attended: Tensor) -> Tensor:
        x = x + block.attn.c_proj(attended)
        changed: Tensor = x + block.mlp(block.ln_2(x))
        return changed

    def scaling(self, block: Any) -> float:
        return float(block.attn.scaling)

    def norm(self, x: Tensor) -> Tensor:
        normed: Tensor = self._model.ln_f(x)
        return normed


def block_shape(model: Any) -> BlockShape:
    """The pieces of a GPT-2 or Llama shaped model."""
    return Learned(model) if model.config.model_type == "gpt2" else Rotary(model)


_PROBED = ((1536, 64), (576, 576), (64, 2))
_MANY = 64


@cache
def least_rows() -> int:
    """Fewest rows of a matrix product that round as they do among many, on this processor.

    MKL takes other paths for fewer: below 4 on an AMD EPYC, below 16 on an Intel Xeon with AVX-512
    (0024). Asked of products of a few shapes, which is a matter of the processor and not of time.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        least = 4
        for wide, out in _PROBED:
            weight = torch.arange(out * wide).sin().view(out, wide)
            many = torch.arange(_MANY * wide).cos().view(_MANY, wide)
            whole = F.linear(many, weight)
            for rows in range(least, _MANY):
                if not torch.equal(F.linear(many[:rows].clone(), weight), whole[:rows]):
                    least = rows + 1
        return least
    finally:
        torch.set_num_threads(threads)


def filled(rows: int) -> Tensor:
    """Numbers 0 to rows - 1, the last one again until there are `least_rows`."""
    return torch.arange(max(rows, least_rows())).clamp(max=rows - 1)


def in_company(compute: Callable[..., Any], *rows: Tensor) -> Any:
    """`compute` of tensors (B, ..., s); few vectors are filled up with copies meanwhile.

    So a row comes out alone as it does among a hundred, to the bit. Slices are copied: of those
    torch makes a product for each row, with weights copied for each.
    """
    rows = tuple(one.contiguous() for one in rows)
    if rows[0].shape[:-1].numel() >= least_rows():
        return compute(*rows)
    count = len(rows[0])
    found = compute(*(one[filled(count)] for one in rows))
    return found[:count] if isinstance(found, Tensor) else tuple(one[:count] for one in found)


def turned(x: Tensor, turn: Turn | None) -> Tensor:
    """Queries or keys (B, heads, K, d) as float32, turned by the angles of their positions."""
    x = x.to(torch.float32)
    if turn is None:
        return x
    cos, sin = turn
    left, right = x.chunk(2, dim=-1)
    return torch.cat([left * cos - right * sin, right * cos + left * sin], dim=-1)


def attend(
    queries: Tensor, keys: Tensor, values: Tensor, scaling: float, visible: Tensor | None
) -> Tensor:
    """What each query gathers (B, Q, H d).

    Args:
        queries: (B, H, Q, d) float32; keys, values (B, G, T, d) float32. H / G neighbouring
            queries share a key head, and meet it as so many queries more: nothing is copied.
        visible: (1 or B, 1, Q, T) bool, who may look at whom; None = everybody at all.
    """
    shared = rearrange(queries, "B (G r) Q d -> B G (r Q) d", G=keys.shape[1])
    weights = shared @ keys.transpose(-1, -2) * scaling
    if visible is not None:
        unseen = repeat(~visible, "B 1 Q T -> B 1 (r Q) T", r=queries.shape[1] // keys.shape[1])
        weights = weights.masked_fill(unseen, float("-inf"))
    gathered = weights.softmax(dim=-1) @ values
    return rearrange(gathered, "B G (r Q) d -> B Q (G r d)", Q=queries.shape[2])


def _heads(x: Tensor, width: int) -> Tensor:
    return rearrange(x, "B K (heads d) -> B heads K d", d=width)
