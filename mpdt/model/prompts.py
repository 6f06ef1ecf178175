"""Soft prompts: one shared part, one low-rank part per task, and what unseen tasks start from.

Axes: N training tasks, n tasks of a batch, l prompt length, s width, r rank.

    P*_k = P_c o P_k,   P_k = v_k u_k        P_c (l, s), v_k (l, r), u_k (r, s)

Source: Zheng et al. 2024 (MPDT), after Wang et al. 2023 (multitask prompt tuning).
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Literal, Protocol

import msgspec
import torch
from torch import Tensor, nn

from mpdt.errors import ShapeError, SpecError, check_above_zero, check_at_least
from mpdt.seeding import generator_at, torch_generator

Start = Literal[
    "cross", "cross_mean", "cross_random", "cross_one", "none", "infer", "infer_aligned"
]
UNTUNED: tuple[Start, ...] = ("none", "infer")
WEIGHTED: tuple[Start, ...] = ("cross_one", "infer", "infer_aligned")


class TrainedPrompts(Protocol):
    """What training leaves for a task: P*_k = cross o P_k, whatever the two are made of."""

    @property
    def cross(self) -> Tensor:
        """(l, s): what may be tuned for an unseen task."""
        ...

    def task_parts(self, rows: Tensor | None = None) -> Tensor:
        """P_k (n, l, s), or (n, 1, 1) of ones where there is nothing of a task's own."""
        ...

    def task_prompts(self, rows: Tensor | None = None, step: int | None = None) -> Tensor:
        """Prompts (n, l, s) of the tasks `rows` (n,), or of all.

        `step` is the update, for prompts that are drawn anew for each (demonstrations).
        """
        ...


class PromptSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Kind, size and start of what stands before the tokens."""

    kind: Literal["decomposed", "shared", "demonstration", "hyper", "none"] = "decomposed"
    """P_c o P_k; one soft prompt for all tasks; steps of an episode (Prompt-DT); weights of
    adapters made from such steps (HDT: rank is their width); nothing."""
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
        generator = torch_generator(seed)
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

    def task_prompts(self, rows: Tensor | None = None, step: int | None = None) -> Tensor:
        """P*_k = P_c o P_k (n, l, s) of the tasks `rows` (n,), or of all."""
        return self.cross * self.task_parts(rows)


class MixedPrompts(DecomposedPrompts):
    """`DecomposedPrompts` whose tasks now and then act with a mixture of other tasks' parts.

        chance `share`:   P_c o sum_j w_j P_j, w one of k's mixtures        else:   P_c o P_k

    Drawn anew for each update and task from (seed, step); without `step` tasks have their own.
    """

    _mixtures: Sequence[Tensor] | None = None

    def mix(self, mixtures: Sequence[Tensor], share: float, seed: int) -> None:
        """From now on; mixtures: per task k weights (m_k, N). Without any, k never mixes."""
        self._mixtures, self._share, self._seed = mixtures, share, seed

    def task_prompts(self, rows: Tensor | None = None, step: int | None = None) -> Tensor:
        """P*_k (n, l, s) of the tasks `rows` (n,), or of all; mixed if `step` says so."""
        if self._mixtures is None or step is None:
            return super().task_prompts(rows)
        chosen = range(len(self._mixtures)) if rows is None else rows.tolist()
        generator = generator_at(self._seed, step)
        weights = torch.zeros(len(chosen), len(self._mixtures))
        for slot, k in enumerate(chosen):
            mixed, which = generator.random() < self._share, generator.random()
            ways = self._mixtures[k]
            if mixed and len(ways):
                weights[slot] = ways[int(which * len(ways))]
            else:
                weights[slot, k] = 1
        return self.cross * torch.einsum("nk,kls->nls", weights, self.task_parts())


class TaughtParts(nn.Module):
    """P_c o P_k with P_k the teacher's prompt of the task, frozen (a variant of the rebuttal).

    Trainables: `cross` (l, s), which starts as N(0, 1): the product spreads like the teacher's.
    """

    cross: nn.Parameter
    parts: Tensor

    def __init__(
        self, settings: PromptSettings, num_tasks: int, width: int, spread: float, seed: int = 0
    ) -> None:
        super().__init__()
        generator = torch_generator(seed)
        self.cross = nn.Parameter(torch.randn((settings.length, width), generator=generator))
        self.register_buffer("parts", torch.zeros(num_tasks, settings.length, width))

    def take(self, prompts: Tensor) -> None:
        """From now on P_k = `prompts` (N, l, s), copied."""
        self.parts.copy_(prompts.detach())

    def task_parts(self, rows: Tensor | None = None) -> Tensor:
        """P_k (n, l, s) of the tasks `rows` (n,), or of all."""
        return self.parts if rows is None else self.parts[rows]

    def task_prompts(self, rows: Tensor | None = None, step: int | None = None) -> Tensor:
        """P_c o P_k (n, l, s) of the tasks `rows` (n,), or of all."""
        return self.cross * self.task_parts(rows)


class TeacherPrompts(nn.Module):
    """A full soft prompt per task: `prompts` (N, l, s), N(0, 1) times the chosen spread."""

    prompts: nn.Parameter

    def __init__(
        self, settings: PromptSettings, num_tasks: int, width: int, spread: float, seed: int = 0
    ) -> None:
        super().__init__()
        std = spread if settings.init_std == "embedding" else settings.init_std
        generator = torch_generator(seed)
        start = torch.randn((num_tasks, settings.length, width), generator=generator)
        self.prompts = nn.Parameter(float(std) * start)

    def task_prompts(self, rows: Tensor | None = None, step: int | None = None) -> Tensor:
        """Prompts (n, l, s) of the tasks `rows` (n,), or of all; rows may repeat."""
        return self.prompts if rows is None else self.prompts[rows]


class SharedPrompt(nn.Module):
    """One soft prompt for all N tasks, `cross` (l, s): the Soft-Prompt baseline.

    Of length 0 it is no prompt at all, which is what MT-BC and MT-ORL have.
    """

    cross: nn.Parameter

    def __init__(
        self, settings: PromptSettings, num_tasks: int, width: int, spread: float, seed: int = 0
    ) -> None:
        super().__init__()
        length = 0 if settings.kind == "none" else settings.length
        std = spread if settings.init_std == "embedding" else settings.init_std
        generator = torch_generator(seed)
        start = float(std) * torch.randn((length, width), generator=generator)
        self.cross = nn.Parameter(start, requires_grad=length > 0)
        self._num_tasks = num_tasks

    def task_parts(self, rows: Tensor | None = None) -> Tensor:
        """Ones (n, 1, 1): no task has a part of its own."""
        return torch.ones(self._num_tasks if rows is None else len(rows), 1, 1)

    def task_prompts(self, rows: Tensor | None = None, step: int | None = None) -> Tensor:
        """The same prompt n times (n, l, s)."""
        return self.cross * self.task_parts(rows)


class AdaptedPrompts(nn.Module):
    """Soft prompts of n unseen tasks, each with its own copy of what is tuned.

    The copies are independent: the loss may be summed over tasks, an element-wise optimiser
    treats each as if it were alone.

    Attributes:
        cross: (n, l, s) the copies of P_c; tuned unless the start says otherwise.
    """

    fixed: Tensor

    def __init__(
        self, trained: TrainedPrompts, start: Start, num_tasks: int,
        weights: Tensor | None = None, seed: int = 0,
    ) -> None:  # fmt: skip
        """Start from trained prompts, which are copied and never changed.

            start           prompt                       tuned
            cross           P_c                          P_c     (the paper's)
            cross_mean      P_c o mean_k P_k             P_c
            cross_one       P_c o P_j, j a donor         P_c
            cross_random    P_c o v u, random            v, u
            none            P_c o mean_k P_k             nothing
            infer           P_c o sum_k w_k P_k          nothing
            infer_aligned   P_c o sum_k w_k P_k          P_c

        Args:
            weights: (n, N) w, one row per unseen task; for `cross_one` (a 1 at the donor) and
                the two of `infer`, and for no other.
            seed: for `cross_random`.
        """
        super().__init__()
        if (weights is not None) != (start in WEIGHTED):
            raise SpecError(
                "weights of training tasks go with some starts, and with no other",
                where=f"start {start}",
                expected=f"weights only for {', '.join(WEIGHTED)}",
                found="none" if weights is None else str(tuple(weights.shape)),
            )
        self.start = start
        cross = trained.cross.detach().repeat(num_tasks, 1, 1)
        tunes_cross = start not in (*UNTUNED, "cross_random")
        self.cross = nn.Parameter(cross, requires_grad=tunes_cross)
        parts = trained.task_parts().detach()
        if start == "cross_random":
            generator = torch_generator(seed)
            length, width = trained.cross.shape
            rank = getattr(trained, "task_v", parts).shape[-1]
            v = torch.randn((num_tasks, length, rank), generator=generator)
            u = torch.randn((num_tasks, rank, width), generator=generator)
            self.task_v, self.task_u = nn.Parameter(v), nn.Parameter(u)
        elif start == "cross":
            self.register_buffer("fixed", torch.ones(num_tasks, 1, 1))
        else:
            if weights is None:
                weights = torch.full((num_tasks, len(parts)), 1 / len(parts))
            if weights.shape != (num_tasks, len(parts)):
                raise ShapeError(
                    "one row of weights per unseen task",
                    expected=str((num_tasks, len(parts))),
                    found=str(tuple(weights.shape)),
                )
            self.register_buffer("fixed", torch.einsum("nk,kls->nls", weights, parts))

    def task_prompts(self, rows: Tensor | None = None, step: int | None = None) -> Tensor:
        """Prompts (n, l, s) of the tasks `rows` (n,), or of all."""
        part = self.task_v @ self.task_u if self.start == "cross_random" else self.fixed
        prompts: Tensor = self.cross * part
        return prompts if rows is None else prompts[rows]

    def select(self, rows: Tensor) -> AdaptedPrompts:
        """A copy with the tasks `rows` (n,) alone."""
        own = copy.deepcopy(self)
        for tensor in (*own.parameters(), *own.buffers()):
            tensor.data = tensor.data[rows].clone()
        return own
