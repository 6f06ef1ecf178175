"""Demonstrations as prompts: steps of a task's own episodes, embedded, before the tokens.

Axes: N training tasks, B demonstrations of each, K' steps of one, q tokens per step, s width.

    bank (N, B, K', ...) ── own input map ──> tokens (n, K' q, s), where a soft prompt would stand

Source: Xu et al. 2022 (Prompt-DT). Theirs gives each window of a task a prompt of its own and
takes an episode's last steps but one; here the windows of one update share the task's prompt,
which is drawn anew for every update, from anywhere in the episode.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor, nn

from mpdt.model.policy import PolicyBatch, embed
from mpdt.model.returns import ReturnTable
from mpdt.model.tokens import InputMap


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
        self.inputs, self._bank, self._returns, self._seed = inputs, bank, returns, seed

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
            words = np.random.SeedSequence([self._seed, step], spawn_key=(2,))
            generator = np.random.Generator(np.random.PCG64(words))
            pick = torch.from_numpy(generator.integers(num, size=len(rows)))
        shown = replace(
            self._bank,
            **{name: value[rows, pick][:, None] for name, value in vars(self._bank).items()},
        )
        tokens, _ = embed(self.inputs, shown, self._returns.select(rows))
        return tokens[:, 0]
