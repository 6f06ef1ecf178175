"""Demonstrations as prompts: steps of a task's own episodes, embedded, before the tokens.

Prompt-DT shows them as they are; HDT makes the weights of small adapters from them.

Axes: N training tasks, B demonstrations of each, K' steps of one, q tokens per step, s width.

    bank (N, B, K', ...) ── own input map ──> tokens (n, K' q, s), where a soft prompt would stand

Source: Xu et al. 2022 (Prompt-DT). Theirs gives each window of a task a prompt of its own and
takes an episode's last steps but one; here the windows of one update share the task's prompt,
which is drawn anew for every update, from anywhere in the episode.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import torch
from einops import rearrange
from torch import Tensor, nn

from mpdt.model.policy import PolicyBatch, embed
from mpdt.model.returns import ReturnTable
from mpdt.model.tokens import InputMap
from mpdt.seeding import Beside, generator_at, layers_from, torch_generator


class DemonstrationPrompts(nn.Module):
    """Trainables: those of `inputs`, the demonstrations' own input map.

    Args:
        bank: windows (N, B, K', ...) without pads.
        returns: N rows, as the policy's.
        seed: of the draw of a demonstration for every task and update.
    """

    def __init__(
        self, inputs: InputMap, bank: PolicyBatch, returns: ReturnTable, seed: int = 0
    ) -> None:
        super().__init__()
        self.inputs, self._returns, self._seed = inputs, returns, seed
        self._bank = self._seen(bank)

    def showing(self, bank: PolicyBatch, returns: ReturnTable) -> DemonstrationPrompts:
        """The same trained numbers over the demonstrations of other tasks."""
        other = copy.copy(self)
        other._bank, other._returns = self._seen(bank), returns
        return other

    def _seen(self, bank: PolicyBatch) -> PolicyBatch:
        """What of a demonstration is looked at."""
        return bank

    @property
    def cross(self) -> Tensor:
        """Ones (l, s): all that is known of a task stands in its demonstration."""
        return torch.ones(self.task_parts().shape[1:])

    def task_parts(self, rows: Tensor | None = None) -> Tensor:
        """The first demonstration of each task as tokens (n, l, s)."""
        return self.task_prompts(rows)

    def task_prompts(self, rows: Tensor | None = None, step: int | None = None) -> Tensor:
        """Tokens (n, l, s) of one demonstration per task: drawn for update `step`, or the first."""
        num_tasks, num = self._bank.mask.shape[:2]
        rows = torch.arange(num_tasks) if rows is None else rows
        pick = torch.zeros(len(rows), dtype=torch.long)
        if step is not None:
            generator = generator_at(self._seed, step, Beside.DEMONSTRATION)
            pick = torch.from_numpy(generator.integers(num, size=len(rows)))
        shown = replace(
            self._bank,
            **{name: value[rows, pick][:, None] for name, value in vars(self._bank).items()},
        )
        tokens, _ = embed(self.inputs, shown, self._returns.select(rows))
        return tokens[:, 0]


class HyperPrompts(DemonstrationPrompts):
    """A hyper-network: demonstration without actions, and layer -> weights of an adapter.

    The prompt it gives is (n, L 2 r, s): for each block r rows that read, then r rows that write
    (from zero, so that training begins without adapters).
    Source: Xu et al. 2023 (HDT), without code. Theirs trains the transformer first and freezes
    it; here both train together.
    """

    def __init__(
        self,
        inputs: InputMap,
        bank: PolicyBatch,
        returns: ReturnTable,
        num_layers: int,
        rank: int,
        width: int,
        seed: int = 0,
    ) -> None:
        super().__init__(inputs, bank, returns, seed)
        with layers_from(seed):
            last = nn.Linear(width, 2 * rank * width)
            self.net = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, width), nn.GELU(), last)
        generator = torch_generator(seed)
        self.layers = nn.Parameter(torch.randn((num_layers, width), generator=generator))
        with torch.no_grad():
            last.weight[rank * width :] = 0
            last.bias[rank * width :] = 0
        self._rows = 2 * rank

    def _seen(self, bank: PolicyBatch) -> PolicyBatch:
        nothing = torch.zeros_like(bank.previous_actions)
        return replace(bank, actions=nothing, previous_actions=nothing)

    def task_prompts(self, rows: Tensor | None = None, step: int | None = None) -> Tensor:
        """Adapter weights (n, L 2 r, s) made from one demonstration per task."""
        shown = super().task_prompts(rows, step).mean(dim=1)
        made = self.net(shown[:, None] + self.layers)
        weights: Tensor = rearrange(made, "n L (q s) -> n (L q) s", q=self._rows)
        return weights
