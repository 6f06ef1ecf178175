"""Validation: the action error on episodes that are not trained on, without the simulator.

    the same windows at every look, uniformly from the slice's episodes of the chosen quality
    a trained task        behind its own prompt
    a task held out whole behind P_c o mean P_k, as an unseen one without adaptation; its return's
                          scale and range are the means of the training tasks'

Statistics of the observations are those of the file, which the held-out episodes are part of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from mpdt.data.slices.sampler import WindowSampler
from mpdt.errors import UsageError
from mpdt.model.demonstrations import DemonstrationPrompts
from mpdt.model.policy import PromptPolicy, action_loss
from mpdt.model.returns import ReturnTable
from mpdt.train.fit.data import Material
from mpdt.train.fit.device import Hardware
from mpdt.train.fit.loop import TaskPrompts

PHASE = "validation"
WINDOWS, BATCHES = 16, 4  # of each task in a batch, so that a look needs little memory; batches


@dataclass
class Validation:
    """Looks at a policy.

    Args:
        window: K of the policy.
        seed: of the windows.
    """

    material: Material
    window: int
    seed: int

    def __post_init__(self) -> None:
        ids = self.material.validation_ids
        self._rows = sorted(ids)
        self._sampler = WindowSampler(
            self.material.dataset, ids, self._rows, self.window, WINDOWS, self.seed
        )

    @torch.no_grad()
    def action_error(
        self, policy: PromptPolicy, prompts: TaskPrompts, returns: ReturnTable, hardware: Hardware
    ) -> float:
        """Mean over all real steps of all windows, in the unit of the training's action loss.

        Args:
            returns: one row per training task, on the device of `hardware`.
        Raises: UsageError for prompts that cannot stand for a task that was held out whole.
        """
        known = {row: slot for slot, row in enumerate(self.material.train_rows)}
        own = [known.get(row, -1) for row in self._rows]
        if -1 in own and isinstance(prompts, DemonstrationPrompts):
            raise UsageError("demonstrations do not stand for a task that is not trained on",
                             where="--validation", hint="hold out --by episode or --by goal"
                             )  # fmt: skip
        slots = hardware.tensor(torch.tensor(own))
        table = ReturnTable(*(
            torch.where(slots < 0, column.mean(), column[slots.clamp_min(0)])
            for column in (returns.scale, returns.low, returns.high, returns.target)
        ))  # fmt: skip
        unseen = prompts.cross * prompts.task_parts().mean(dim=0) if -1 in own else None
        error, steps = 0.0, 0
        for number in range(BATCHES):
            windows = self._sampler.batch(number)
            batch = hardware.batch(windows)
            rows = hardware.tensor(torch.from_numpy(windows.slots))
            of_tasks = slots[rows]
            chosen = prompts.task_prompts(of_tasks.clamp_min(0))
            if unseen is not None:
                chosen = torch.where((of_tasks < 0)[:, None, None], unseen, chosen)
            with hardware.autocast():
                output = policy(batch, chosen, table.select(rows))
                assert batch.actions is not None
                loss = action_loss(output.actions, batch.actions, batch.mask)
            count = int(np.count_nonzero(windows.mask))
            error, steps = error + count * float(loss), steps + count
        return error / steps


def best_look(records: Sequence[Mapping[str, Any]]) -> tuple[int, int]:
    """Update of the look with the smallest error, the first of equals; and how many came after.

    errors 0.5 0.3 0.4 at 10 20 30   ->   20, 1
    """
    looks = [(r["step"], r["action_error"]) for r in records if r["phase"] == PHASE]
    errors = [error for _, error in looks]
    place = errors.index(min(errors))
    return int(looks[place][0]), len(looks) - 1 - place
