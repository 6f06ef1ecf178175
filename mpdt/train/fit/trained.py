"""What training leaves in memory: all that adaptation, judging and acting start from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from torch import nn

from mpdt.model.policy import PromptPolicy
from mpdt.model.returns import ReturnTable
from mpdt.train.fit.data import Material
from mpdt.train.fit.loop import TaskPrompts


@dataclass(frozen=True)
class Trained:
    """One policy behind a prompt for each of N training tasks.

    Attributes:
        returns: N rows.
        material: what it was trained on; the test tasks lie in there as well.
        steps, asked: updates done and asked for, by phase.
    """

    policy: PromptPolicy
    prompts: TaskPrompts
    returns: ReturnTable
    material: Material
    steps: Mapping[str, int]
    asked: Mapping[str, int]

    @property
    def complete(self) -> bool:
        """Whether no time limit cut the training short."""
        return dict(self.steps) == dict(self.asked)

    @property
    def num_trainables(self) -> int:
        """Numbers that were trained: prompts, time table, head and, where it trains, the map."""
        modules: list[nn.Module] = [self.policy, self.prompts]
        return sum(p.numel() for m in modules for p in m.parameters() if p.requires_grad)
