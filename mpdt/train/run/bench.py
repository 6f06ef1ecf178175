"""Bench: what everybody who is judged on a file's tasks has in common: seeds, trivial rows, expert.

zero, random, best constant   run here, on the same seeds; the constant is the one in the file
expert                        the reference in the file, where the horizon is the same

The trained policy (`judge.py`) and policies that are not ours (`outside.py`) are judged by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray

from mpdt.data.reference import UNKNOWN, Reference
from mpdt.data.sim.actors import Actor, ConstantPolicy, UniformPolicy, ZeroPolicy
from mpdt.train.evaluate.rollout import (
    Evaluation,
    EvaluationSettings,
    Kept,
    SimulatorCache,
    evaluate,
)
from mpdt.train.evaluate.score import (
    CONSTANT,
    RANDOM,
    ZERO,
    Block,
    Reads,
    Score,
    expert_scores,
    not_measured,
    scores_of,
)
from mpdt.train.fit.data import Material
from mpdt.train.run.progress import Progress


@dataclass
class Bench:
    """Runs actors on tasks of a file, `rows` of its table."""

    material: Material
    settings: EvaluationSettings
    progress: Progress
    simulators: SimulatorCache = field(default_factory=SimulatorCache)

    @property
    def horizon(self) -> int:
        """Steps of an episode here."""
        return self.settings.horizon or self.material.horizon

    def episodes(self, block: Block) -> int:
        """Episodes of each task."""
        return (self.settings.train_episodes if block == "train" else 0) or self.settings.episodes

    def run(
        self, block: Block, label: str, rows: Sequence[int], actor: Actor, kept: Kept | None = None
    ) -> Evaluation:
        """All episodes of these tasks in one batch. Raises: Stopped after a signal."""
        material, settings = self.material, self.settings
        with torch.no_grad():
            return evaluate(
                actor, material.family, material.tasks(rows), material.options, self.horizon,
                self.episodes(block), settings.seed, settings.max_rows,
                partial(self.progress.update, label), self.simulators.make,
                partial(material.goal_key, block=block), kept,
            )  # fmt: skip

    def score(
        self,
        block: Block,
        method: str,
        rows: Sequence[int],
        actor: Actor,
        reads: Reads | None = None,
        kept: Kept | None = None,
    ) -> list[Score]:
        """The rows of one method; without a simulator they say that nothing was measured."""
        if not self.material.family.simulates:
            names = [task.name for task in self.material.tasks(rows)]
            blank = not_measured(block, method, names)
            return [msgspec.structs.replace(score, reads=reads) for score in blank]
        result = self.run(block, f"{block}: {method}", rows, actor, kept)
        return self.scores_of(block, method, rows, result, reads)

    def scores_of(
        self, block: Block, method: str, rows: Sequence[int], found: Evaluation,
        reads: Reads | None = None,
    ) -> list[Score]:  # fmt: skip
        """As rows of the table."""
        random, expert = self._means("random", rows), self._means("expert", rows)
        return scores_of(
            block, method, found.tasks, found.returns, found.successes, random, expert, reads,
            self.material.num_goals(block),
        )  # fmt: skip

    def references(self, block: Block, rows: Sequence[int]) -> list[Score]:
        """The rows of zero action, random, best constant and expert."""
        family = self.material.family
        constant = self._constant_action() if self.settings.constants else None
        size, low, high = family.action_size, family.action_low, family.action_high
        zero = self.score(block, ZERO, rows, ZeroPolicy(size))
        scores = zero + self.score(block, RANDOM, rows, UniformPolicy(size, low, high))
        names = [task.name for task in self.material.tasks(rows)]
        if constant is None:
            scores += not_measured(block, CONSTANT, names)
        elif not constant.any():
            scores += [msgspec.structs.replace(score, method=CONSTANT) for score in zero]
        else:
            scores += self.score(block, CONSTANT, rows, ConstantPolicy(constant))
        experts = self._stored("expert", rows)
        return scores + expert_scores(block, names, experts, self._means("random", rows))

    def _stored(self, name: str, rows: Sequence[int]) -> list[Reference]:
        """References (n,) of the file; unknown where the horizon judged here is another."""
        references = self.material.dataset.tasks.references
        if self.horizon != self.material.horizon:
            return [UNKNOWN] * len(rows)
        return [references[row][name] for row in rows]

    def _means(self, name: str, rows: Sequence[int]) -> NDArray[np.float64]:
        return np.array([reference.mean for reference in self._stored(name, rows)])

    def _constant_action(self) -> NDArray[np.float32] | None:
        """The family's best constant action, chosen on training tasks when the file was made."""
        tasks = self.material.dataset.tasks
        actions = {references.constant_action for references in tasks.references}
        return np.array(actions.pop(), np.float32) if len(actions) == 1 and any(actions) else None
