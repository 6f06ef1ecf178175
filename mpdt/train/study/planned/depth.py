"""Study `depth`: MPDT-ones with 4, 12 and all 30 blocks, GPT-2's shape, longer windows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mpdt.train.study.recipes import (
    LONG,
    STARTS,
    VEL,
    Cell,
    one,
)


def _deep(data: str, depth: int, changes: Mapping[str, Any] | None = None) -> Cell:
    size = {} if data == VEL else LONG
    return one(data, "MPDT-ones", size, {"backbone": {"depth": depth}}, STARTS, changes or {},
                label=f"ones-depth-{depth}")  # fmt: skip


# SmolLM2-135M has 30 blocks. GPT-2's shape needs its own weights, which no cache here has: its 12
# blocks are drawn at random.
DEPTH: tuple[Cell, ...] = (
    *(_deep(data, depth) for depth in (4, 12, 30) for data in (VEL, "ml10")),
    *(one(data, "MPDT-ones", {} if data == VEL else LONG, STARTS,
           {"backbone": {"name": "random:gpt2", "depth": 12}}, label="ones-gpt2-12")
      for data in (VEL, "ml10")),
    *(one("ml10", "MPDT-ones", LONG, STARTS, {"sampler": {"window": window}},
           label=f"ones-window-{window}") for window in (50, 500)),
)  # fmt: skip
