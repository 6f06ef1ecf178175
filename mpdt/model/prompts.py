"""Soft prompts: one shared part, one low-rank part per task, and what unseen tasks start from.

Axes: N training tasks, n tasks of a batch, l prompt length, s width, r rank.

    P*_k = P_c o P_k,   P_k = v_k u_k        P_c (l, s), v_k (l, r), u_k (r, s)

Source: Zheng et al. 2024 (MPDT), after Wang et al. 2023 (multitask prompt tuning).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import msgspec
import torch
from torch import Tensor, nn

from mpdt.errors import ShapeError, SpecError
from mpdt.model.limits import check_above_zero, check_at_least

Start = Literal["cross", "cross_mean", "cross_random", "cross_one", "none"]


class PromptSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Size and start of the soft prompts."""

    length: int = 30
    rank: int = 1
    init_std: float | Literal["embedding"] = "embedding"
    """Spread of P_c; the paper's is 1.0. embedding: P_c o P_k spreads like the word embeddings."""
    task_init: Literal["normal", "ones"] = "normal"
    """normal: v_k, u_k ~ N(0, 1), the paper's. ones: P_k starts near 1, P_c alone is a policy."""
    task_noise: float = 0.1
    """Spread around the start `ones`; the tasks must not start equal in every rank."""

    def __post_init__(self) -> None:
        check_at_least("prompts.length", self.length, 1)
        check_at_least("prompts.rank", self.rank, 1)
        if self.init_std != "embedding":
            check_above_zero("prompts.init_std", self.init_std)
        check_at_least("prompts.task_noise", self.task_noise, 0)


class DecomposedPrompts(nn.Module):
    """Trainables: `cross` (l, s), `task_v` (N, l, r), `task_u` (N, r, s).

    Args:
        spread: standard deviation of the backbone's word embeddings, for `init_std` embedding.
    """

    cross: nn.Parameter
    task_v: nn.Parameter
    task_u: nn.Parameter

    def __init__(
        self, settings: PromptSettings, num_tasks: int, width: int, spread: float, seed: int = 0
    ) -> None:
        super().__init__()
        std = settings.init_std
        if std == "embedding":
            # The product of independent entries with spreads a, 1 and 1 summed over r terms
            # has spread a * sqrt(r).
            std = spread / settings.rank**0.5 if settings.task_init == "normal" else spread
        generator = torch.Generator().manual_seed(seed)
        length, rank = settings.length, settings.rank

        def normal(*shape: int) -> Tensor:
            return torch.randn(shape, generator=generator)

        self.cross = nn.Parameter(float(std) * normal(length, width))
        v, u = normal(num_tasks, length, rank), normal(num_tasks, rank, width)
        if settings.task_init == "ones":
            v, u = 1 + settings.task_noise * v, (1 + settings.task_noise * u) / rank
        self.task_v, self.task_u = nn.Parameter(v), nn.Parameter(u)

    def task_parts(self, rows: Tensor | None = None) -> Tensor:
        """P_k = v_k u_k (n, l, s) of the tasks `rows` (n,), or of all."""
        v, u = self.task_v, self.task_u
        return v @ u if rows is None else v[rows] @ u[rows]

    def task_prompts(self, rows: Tensor | None = None) -> Tensor:
        """P*_k = P_c o P_k (n, l, s) of the tasks `rows` (n,), or of all."""
        return self.cross * self.task_parts(rows)


class TeacherPrompts(nn.Module):
    """A full soft prompt per task: `prompts` (N, l, s), N(0, 1) times the chosen spread.

    With one task it is the universal prompt of the Soft-Prompt baseline.
    """

    prompts: nn.Parameter

    def __init__(
        self, settings: PromptSettings, num_tasks: int, width: int, spread: float, seed: int = 0
    ) -> None:
        super().__init__()
        std = spread if settings.init_std == "embedding" else settings.init_std
        generator = torch.Generator().manual_seed(seed)
        start = torch.randn((num_tasks, settings.length, width), generator=generator)
        self.prompts = nn.Parameter(float(std) * start)

    def task_prompts(self, rows: Tensor | None = None) -> Tensor:
        """Prompts (n, l, s) of the tasks `rows` (n,), or of all; rows may repeat."""
        return self.prompts if rows is None else self.prompts[rows]


class AdaptedPrompts(nn.Module):
    """Soft prompts of n unseen tasks, each with its own copy of what is tuned.

    The copies are independent: the loss may be summed over tasks, an element-wise optimiser
    treats each as if it were alone.

    Attributes:
        cross: (n, l, s) the tuned copies of P_c, or fixed for `cross_random` and `none`.
    """

    fixed: Tensor

    def __init__(
        self, trained: DecomposedPrompts, start: Start, num_tasks: int,
        donors: Sequence[int] | None = None, seed: int = 0,
    ) -> None:  # fmt: skip
        """Start from trained prompts, which are copied and never changed.

            start           prompt                 tuned
            cross           P_c                    P_c     (the paper's)
            cross_mean      P_c o mean_k P_k       P_c
            cross_one       P_c o P_j, j a donor   P_c
            cross_random    P_c o v u, random      v, u
            none            P_c o mean_k P_k       nothing

        Args:
            donors: rows of training tasks, one per unseen task; only for `cross_one`.
            seed: for `cross_random`.
        """
        super().__init__()
        if (donors is not None) != (start == "cross_one"):
            raise SpecError(
                "donor tasks go with the start cross_one, and with no other",
                where=f"start {start}",
                expected="donors" if start == "cross_one" else "no donors",
                found=str(donors),
            )
        if donors is not None and len(donors) != num_tasks:
            raise ShapeError(
                "one donor per unseen task", expected=str(num_tasks), found=str(len(donors))
            )
        self.start = start
        cross = trained.cross.detach().repeat(num_tasks, 1, 1)
        self.cross = nn.Parameter(cross, requires_grad=start not in ("cross_random", "none"))
        parts = trained.task_parts().detach()
        if start == "cross_random":
            generator = torch.Generator().manual_seed(seed)
            shapes = (trained.task_v.shape[1:], trained.task_u.shape[1:])
            v, u = (torch.randn((num_tasks, *shape), generator=generator) for shape in shapes)
            self.task_v, self.task_u = nn.Parameter(v), nn.Parameter(u)
        elif start == "cross":
            self.register_buffer("fixed", torch.ones(num_tasks, 1, 1))
        elif donors is not None:
            self.register_buffer("fixed", parts[list(donors)])
        else:
            self.register_buffer("fixed", parts.mean(dim=0).repeat(num_tasks, 1, 1))

    def task_prompts(self, rows: Tensor | None = None) -> Tensor:
        """Prompts (n, l, s) of the tasks `rows` (n,), or of all."""
        part = self.task_v @ self.task_u if self.start == "cross_random" else self.fixed
        prompts: Tensor = self.cross * part
        return prompts if rows is None else prompts[rows]
