"""Returns-to-go as the policy sees them: divided by a scale, kept inside the range of training.

The trap this guards against: a policy trained on returns between -1.7 and 0 and evaluated from
a target of 0 upwards stands still, and no loss shows it. So every task carries its own scale,
the range its training data covered, and a target from inside that range.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from mpdt.errors import DataError


@dataclass(frozen=True)
class ReturnTable:
    """One row per task, each column (N,) float32 in raw units of the task's reward.

    Attributes:
        scale: what a return-to-go is divided by, > 0.
        low, high: smallest and largest return-to-go of the training data.
        target: where a closed loop starts unless told otherwise.
    """

    scale: Tensor
    low: Tensor
    high: Tensor
    target: Tensor

    def __post_init__(self) -> None:
        if not bool((self.scale > 0).all()):
            raise DataError("the scale of a return-to-go must be positive", where="ReturnTable")
        if not bool((self.low <= self.high).all()):
            raise DataError("the range of a return-to-go is upside down", where="ReturnTable")

    def __len__(self) -> int:
        return int(self.scale.shape[0])

    def select(self, rows: Tensor) -> ReturnTable:
        """The rows given by `rows` (n,) int, in that order; rows may repeat."""
        return ReturnTable(self.scale[rows], self.low[rows], self.high[rows], self.target[rows])

    def normalise(self, returns_to_go: Tensor, clip: bool) -> Tensor:
        """Raw (N, ...) -> (N, ...): first clipped to the training range, then divided.

        low -100, high 0, scale 100:   -150 -> -1.0    -40 -> -0.4    +20 -> 0.0
        """
        shape = (-1,) + (1,) * (returns_to_go.dim() - 1)
        if clip:
            returns_to_go = torch.clamp(
                returns_to_go, self.low.reshape(shape), self.high.reshape(shape)
            )
        return returns_to_go / self.scale.reshape(shape)

    def pooled(self, targets: Sequence[float]) -> ReturnTable:
        """Rows for unseen tasks: mean scale and widest range of these rows, own targets."""
        num = len(targets)
        return ReturnTable(
            self.scale.mean().repeat(num),
            self.low.min().repeat(num),
            self.high.max().repeat(num),
            torch.tensor(list(targets), dtype=torch.float32),
        )
