"""Group: several processes that train as one, each on its share of every update's windows.

    windows (n, M, ...)    rank 0 of 2: M 0 ... M/2 - 1      rank 1: the rest

    loss of the update  =  sum over ranks of (real steps here / real steps in all) * loss here

so the loss is that of one process with the whole batch, whatever was padded where. What a
`DistributedDataParallel` module averages is the mean of the ranks' means, which is not; hence the
gradients, a few hundred thousand numbers, are added up here, in one message per update.

Started by `torchrun --nproc-per-node N`. Every rank draws the same batch and cuts out its part,
so the sampler knows nothing of ranks.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import torch
import torch.distributed as dist
from torch import Tensor

from mpdt.data.slices.windows import WindowBatch
from mpdt.errors import UsageError

_BY_WINDOW = (
    "observations", "previous_actions", "actions", "returns_to_go", "timesteps", "mask",
    "episodes", "starts",
)  # fmt: skip


@dataclass(frozen=True)
class Group:
    """`size` processes, of which this is number `rank`; a group of one does nothing."""

    rank: int = 0
    size: int = 1

    @classmethod
    def join(cls, backend: str = "gloo") -> Group:
        """The group `torchrun` has put this process into; alone without it."""
        size = int(os.environ.get("WORLD_SIZE", "1"))
        if size == 1:
            return cls()
        if not dist.is_initialized():
            dist.init_process_group(backend)
        return cls(dist.get_rank(), size)

    def leave(self) -> None:
        """Wait for the others, then close: who ends with open connections may abort."""
        if self.size > 1:
            dist.barrier()
            dist.destroy_process_group()

    def share(self, windows: WindowBatch) -> WindowBatch:
        """This rank's windows of every task.

        Raises: UsageError if they cannot be shared out evenly.
        """
        if self.size == 1:
            return windows
        per_task, over = divmod(windows.mask.shape[1], self.size)
        if over:
            raise UsageError("windows per task cannot be shared out evenly",
                             where="sampler.per_task", expected=f"a multiple of {self.size}",
                             found=str(windows.mask.shape[1]))  # fmt: skip
        own = slice(self.rank * per_task, (self.rank + 1) * per_task)
        return replace(windows, **{name: getattr(windows, name)[:, own] for name in _BY_WINDOW})

    def weight(self, mask: Tensor) -> float:
        """Real steps of `mask` here over those of all ranks; 1 alone."""
        if self.size == 1:
            return 1.0
        here = mask.sum().to(torch.float64)
        return float(here / self.total(here))

    def total(self, values: Tensor) -> Tensor:
        """Sum over all ranks; carries no gradient."""
        summed = values.detach().clone()
        if self.size > 1:
            dist.all_reduce(summed)
        return summed

    def add_gradients(self, parameters: Iterable[Tensor]) -> None:
        """Every rank's gradients become the sum of all, in one message."""
        if self.size == 1:
            return
        parameters = list(parameters)
        for parameter in parameters:  # the same message from every rank
            if parameter.grad is None:
                parameter.grad = torch.zeros_like(parameter)
        gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
        flat = torch.cat([gradient.flatten() for gradient in gradients])
        dist.all_reduce(flat)
        sizes = [gradient.numel() for gradient in gradients]
        for gradient, summed in zip(gradients, torch.split(flat, sizes), strict=True):
            gradient.copy_(summed.view_as(gradient))

    def any(self, flags: Sequence[bool]) -> list[bool]:
        """What at least one rank says yes to; all ranks then do the same."""
        if self.size == 1:
            return list(flags)
        counts = self.total(torch.tensor([float(flag) for flag in flags]))
        return [bool(count > 0) for count in counts]


ALONE = Group()
