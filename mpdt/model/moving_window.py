"""The newest token of a window that moves on by one step: what a closed loop asks at every step.

Axes: B rows, m new tokens, s width, l prompt length, L blocks.

    new tokens ── first block's projections ──> kept beside those of the tokens before them
                                                    │ turned by where they stand now
    L = 1    the newest token alone ───────────────> block ──> norm ──> hidden (B, s)
    L > 1    all tokens through the blocks but the last, the newest one alone through that

Exact, for two reasons (docs/decisions/0024). Attention is causal and a window is judged by its
newest token, so the last block owes nobody else an answer. And what the first block projects
from a token depends on that token alone as long as positions only turn it. Behind the first
block a token has seen others that have left the window since, so nothing can be kept there.
"""

from __future__ import annotations

import copy
from functools import partial

import torch
from torch import Tensor

from mpdt.model.adapters import bottleneck
from mpdt.model.backbone import Backbone, positions_of, visible_to
from mpdt.model.blocks import attend, block_shape, in_company, turned
from mpdt.model.prefix import PrefixCache

_AT_ONCE = 400
"""Tokens that go through blocks together: enough for the matrix products, few enough that what
stands between them stays in the processor's cache."""


class MovingWindow:
    """The last tokens of B rows, each behind its own prompt. No gradients.

    Equal to `Backbone.forward_with_cache` on the same windows, whose last hidden vector it gives.

    Args:
        prefix: B rows, or none at all.
        most: tokens a window holds when it is full.
    """

    def __init__(self, backbone: Backbone, prefix: PrefixCache, rows: int, most: int) -> None:
        backbone.check_room(prefix.length, most)
        self._blocks = list(backbone.blocks())
        self._shape = block_shape(backbone.model)
        self._dtype, self._most = backbone.dtype, most
        self._length, self._adapters = prefix.length, prefix.adapters
        # Attention computes in float32 whatever the weights are: in bfloat16 its small products
        # are an order of magnitude slower, and rounded.
        self._prompt_keys = [keys.to(torch.float32) for keys in prefix.keys]
        self._prompt_values = [values.to(torch.float32) for values in prefix.values]
        self._kept: list[Tensor] = []
        self._held = torch.zeros(rows, dtype=torch.long)

    def forget(self, rows: Tensor) -> None:
        """Empty the windows of `rows` (B,) bool; the others stay as they are."""
        self._held[rows] = 0
        for kept in self._kept:
            kept[rows] = 0.0  # masked, but a NaN would get through a weight of 0

    def fork(self) -> MovingWindow:
        """The same windows once more; what is appended to one the other does not hold."""
        other = copy.copy(self)
        other._held, other._kept = self._held.clone(), [kept.clone() for kept in self._kept]
        return other

    def append(self, tokens: Tensor, real: Tensor) -> Tensor:
        """Hidden vectors (B, s) float32 of the newest tokens, after the final norm.

        Args:
            tokens: (B, m, s); the last of them is the one that is asked.
            real: (B,) how many of the m, counted from the end, a row really has.
        """
        self._held = (self._held + real).clamp(max=self._most)
        mask = torch.arange(self._most) >= self._most - self._held[:, None]
        if mask.all():
            mask = mask[:1]
        positions = positions_of(mask, self._length)
        first = self._first(tokens.to(self._dtype), positions)
        numbers = torch.arange(len(tokens))
        parts = 1
        if len(self._blocks) > 1:
            parts = min(len(tokens) * self._most // _AT_ONCE, len(tokens))
        hidden = [
            self._through(slice(int(rows[0]), int(rows[-1]) + 1), first, mask, positions)
            for rows in numbers.tensor_split(max(parts, 1))
        ]
        return torch.cat(hidden)

    def _through(
        self, rows: slice, first: tuple[Tensor, ...], mask: Tensor, positions: Tensor
    ) -> Tensor:
        """Hidden vectors (rows, s) from what `_first` gave of all rows."""
        x, queries, keys, values = (one[rows] for one in first)
        if len(mask) > 1:
            mask, positions = mask[rows], positions[rows]
        full, visible = bool(mask.all()), visible_to(mask, self._length)
        turn = self._shape.turn(positions)
        for number, block in enumerate(self._blocks):
            last = number == len(self._blocks) - 1
            if number:
                project = partial(self._shape.project, block, newest=last)
                queries, keys, values = in_company(project, x)
            if last:
                x, seen = x[:, -1:], None if full else visible[:, :, -1:]
                now = None if turn is None else (turn[0][:, :, -1:], turn[1][:, :, -1:])
            else:
                seen, now = visible, turn
            keys, values = turned(keys, turn), values.to(torch.float32)
            if self._length:
                keys = torch.cat([self._prompt_keys[number][rows], keys], dim=2)
                values = torch.cat([self._prompt_values[number][rows], values], dim=2)
            scaling = self._shape.scaling(block)
            gathered = attend(turned(queries, now), keys, values, scaling, seen)
            x = in_company(partial(self._shape.rest, block), x, gathered.to(self._dtype))
            if self._adapters is not None:
                x = x + bottleneck(x, self._adapters[rows, number])
        return self._shape.norm(x)[:, -1].to(torch.float32)

    def _first(self, tokens: Tensor, positions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """What enters the first block, and what that projects: queries, keys and values."""
        shape, block, alone = self._shape, self._blocks[0], len(self._blocks) == 1
        if not shape.relative:
            (window,) = self._keep(tokens)
            x = shape.enter(window, positions)
            return (x, *shape.project(block, x, newest=alone))
        queries, keys, values = in_company(partial(shape.project, block, newest=alone), tokens)
        if alone:  # older tokens are only looked at
            keys, values = self._keep(keys, values)
            return tokens, queries, keys, values
        x, queries, keys, values = self._keep(tokens, queries, keys, values)
        return x, queries, keys, values

    def _keep(self, *new: Tensor) -> list[Tensor]:
        """Move the windows on; tokens stand on the last axis but one, the newest at its end.

        All columns are there from the beginning, zeros behind a mask: what a row computes does
        not depend on how old the others are, to the bit.
        """
        if not self._kept:
            sizes = [(*one.shape[:-2], self._most, one.shape[-1]) for one in new]
            self._kept = [one.new_zeros(size) for one, size in zip(new, sizes, strict=True)]
        self._kept = [
            torch.cat([old[..., one.shape[-2] :, :], one[..., -self._most :, :]], dim=-2)
            for old, one in zip(self._kept, new, strict=True)
        ]
        return self._kept


def prompt_prefix(backbone: Backbone, prompts: Tensor | None) -> PrefixCache:
    """What prompts (n, l, s) leave behind for acting. No gradients.

    Equal to `Backbone.encode_prefix`, in the pieces of `blocks.py`, so that it needs no more of
    a language model than `light.py` has. One prompt after the other: its keys do not depend on
    the company it is in, to the bit.
    """
    if prompts is None or prompts.shape[1] == 0 or backbone.reads_adapters:
        return backbone.encode_prefix(prompts)
    backbone.check_room(prompts.shape[1], 0)
    each = [_one_prefix(backbone, prompt[None]) for prompt in prompts]
    keys, values = ([torch.cat(rows) for rows in zip(*side, strict=True)]
                    for side in zip(*each, strict=True))  # fmt: skip
    return PrefixCache(tuple(keys), tuple(values), int(prompts.shape[1]))


def _one_prefix(backbone: Backbone, prompt: Tensor) -> tuple[list[Tensor], list[Tensor]]:
    """Keys and values (1, G, l, d) float32 of every block."""
    shape, length = block_shape(backbone.model), prompt.shape[1]
    mask = torch.ones(1, length, dtype=torch.bool)
    positions, visible = positions_of(mask, 0), visible_to(mask, 0)
    turn, x = shape.turn(positions), shape.enter(prompt.to(backbone.dtype), positions)
    all_keys, all_values = [], []
    for block in backbone.blocks():
        queries, keys, values = shape.project(block, x, newest=False)
        keys, values = turned(keys, turn), values.to(torch.float32)
        gathered = attend(turned(queries, turn), keys, values, shape.scaling(block), visible)
        x = shape.rest(block, x, gathered.to(backbone.dtype))
        all_keys.append(keys)
        all_values.append(values)
    return all_keys, all_values
