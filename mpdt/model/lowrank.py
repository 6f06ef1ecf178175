"""LoRA: a frozen weight plus a trained product of rank r, on the attention's input projections.

    W' = W + alpha / r * up down        up (rows, r) from zero, down (r, columns) Gaussian

Source: Hu et al. 2021; r = 16, alpha = 32 on q, k and v as in LaMo (Shi et al. 2023), whose
dropout on the branch's input is left out.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from mpdt.seeding import torch_generator

_PROJECTIONS = ("c_attn", "q_proj", "k_proj", "v_proj")  # GPT-2's; Llama's


class LowRank(nn.Module):
    """A parametrisation of one weight; trainables `up` and `down`, float32."""

    def __init__(self, weight: Tensor, rank: int, alpha: float, generator: torch.Generator) -> None:
        super().__init__()
        rows, columns = weight.shape
        start = torch.randn((rank, columns), generator=generator) / columns**0.5
        self.down = nn.Parameter(start)
        self.up = nn.Parameter(torch.zeros(rows, rank))
        self._scale = alpha / rank

    def forward(self, weight: Tensor) -> Tensor:
        return weight + (self._scale * self.up @ self.down).to(weight.dtype)


def add_low_rank(model: nn.Module, rank: int, alpha: float, seed: int) -> None:
    """Put a `LowRank` on every attention projection of `model`, in the order of its modules."""
    generator = torch_generator(seed)
    for name, module in list(model.named_modules()):
        if name.rpartition(".")[2] in _PROJECTIONS:
            weight = module.weight
            assert isinstance(weight, Tensor)
            parametrize.register_parametrization(
                module, "weight", LowRank(weight, rank, alpha, generator)
            )
