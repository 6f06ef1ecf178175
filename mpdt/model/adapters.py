"""Adapters: a small bottleneck behind every block, with weights of each row's own.

    h  ->  h + up gelu(down h)        weights (B, L, 2, r, s): down, then up, of L blocks

Source: Houlsby et al. 2019; made by a hyper-network in HDT (Xu et al. 2023).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn


def bottleneck(h: Tensor, weights: Tensor) -> Tensor:
    """What is added to a block's output h (B, K, s), weights (B, 2, r, s) of that block."""
    down, up = weights.unbind(dim=1)
    inner = F.gelu(torch.einsum("bks,brs->bkr", h.to(torch.float32), down))
    return torch.einsum("bkr,brs->bks", inner, up).to(h.dtype)


@contextmanager
def adapted(blocks: nn.ModuleList, adapters: Tensor | None) -> Iterator[None]:
    """Inside, the blocks answer with their adapters; None changes nothing."""

    def behind(weights: Tensor) -> Any:
        def add(_module: nn.Module, _args: Any, output: Any) -> Any:
            h = output[0] if isinstance(output, tuple) else output
            h = h + bottleneck(h, weights)
            return (h, *output[1:]) if isinstance(output, tuple) else h

        return add

    handles = []
    if adapters is not None:
        handles = [
            block.register_forward_hook(behind(adapters[:, i])) for i, block in enumerate(blocks)
        ]
    try:
        yield
    finally:
        for handle in handles:
            handle.remove()
