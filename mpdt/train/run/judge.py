"""After training: adapt to the test tasks, run everybody in the simulator, fill the table.

training tasks   zero, random, best constant, expert | the method, each task behind its own prompt
test tasks       zero, random, best constant, expert | every one of `adapt/candidates.py`

All but the expert are run here, on the same seeds; the constant action is the one in the file.
The expert is the reference in the file, where the horizon is the same.
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
from mpdt.train.adapt.candidates import Candidates
from mpdt.train.bundle.contents import ActingPrompts, own_prompts, prompts_of
from mpdt.train.evaluate.rollout import Evaluation, SimulatorCache, evaluate
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
    with_verdicts,
)
from mpdt.train.fit.log import MetricsLog
from mpdt.train.fit.trained import Trained
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.progress import Progress


@dataclass
class Judge:
    """The phases after training.

    Args:
        log: where adaptation writes; None = nowhere.
    Attributes:
        acting: the prompts that `scores` has judged.
    """

    trained: Trained
    config: TrainConfig
    progress: Progress
    log: MetricsLog | None = None
    simulators: SimulatorCache = field(default_factory=SimulatorCache)
    acting: list[ActingPrompts] = field(default_factory=list)

    def scores(self) -> list[Score]:
        """All rows of the final table. Raises: Stopped after a signal."""
        material, config = self.trained.material, self.config
        blocks = config.evaluation.blocks
        constant = self._constant_action() if config.evaluation.constants else None
        candidates = Candidates(self.trained, config, self.progress.update, self.log)
        scores, references = list[Score](), list[Score]()
        self.acting = [own_prompts(self.trained)]
        if "train" in blocks:
            own = candidates.own()
            references = self._references("train", material.train_rows, constant)
            scores = references + self._score("train", config.method, material.train_rows, own)
        if not material.test_rows or "test" not in blocks:
            return with_verdicts(scores)
        same = config.evaluation.train_episodes in (0, config.evaluation.episodes)
        if material.goals is not None:  # the tasks are known, their goals are not
            label = f"{config.method} own prompts"
            scores += self._score("test", label, material.test_rows, candidates.own(), "task id")
        if references and same and material.one_table:
            # The same episodes: a trivial policy is run on a task once.
            scores += [msgspec.structs.replace(score, block="test") for score in references]
        else:
            scores += self._references("test", material.test_rows, constant)
        for candidate in candidates:
            self.acting.append(prompts_of(candidate, material.test_rows, candidates.returns))
            label = f"{config.method} {candidate.label}"
            scores += self._score(
                "test", label, material.test_rows, candidate.controller, candidate.reads
            )
        return with_verdicts(scores)

    def _evaluate(
        self, block: Block, label: str, rows: Sequence[int], actor: Actor, episodes: int,
    ) -> Evaluation:  # fmt: skip
        material, settings = self.trained.material, self.config.evaluation
        with torch.no_grad():
            return evaluate(
                actor, material.family, material.tasks(rows), material.options,
                settings.horizon or material.horizon, episodes, settings.seed, settings.max_rows,
                partial(self.progress.update, label), self.simulators.make,
                partial(material.goal_key, block=block),
            )  # fmt: skip

    def _score(
        self,
        block: Block,
        method: str,
        rows: Sequence[int],
        actor: Actor,
        reads: Reads | None = None,
    ) -> list[Score]:
        settings = self.config.evaluation
        episodes = (settings.train_episodes if block == "train" else 0) or settings.episodes
        result = self._evaluate(block, f"{block}: {method}", rows, actor, episodes)
        random, expert = self._means("random", rows), self._means("expert", rows)
        return scores_of(
            block, method, result.tasks, result.returns, result.successes, random, expert, reads
        )

    def _stored(self, name: str, rows: Sequence[int]) -> list[Reference]:
        """References (n,) of the file; unknown where the horizon judged here is another."""
        references = self.trained.material.dataset.tasks.references
        horizon = self.config.evaluation.horizon
        if horizon not in (0, self.trained.material.horizon):
            return [UNKNOWN] * len(rows)
        return [references[row][name] for row in rows]

    def _means(self, name: str, rows: Sequence[int]) -> NDArray[np.float64]:
        return np.array([reference.mean for reference in self._stored(name, rows)])

    def _constant_action(self) -> NDArray[np.float32] | None:
        """The family's best constant action, chosen on training tasks when the file was made."""
        tasks = self.trained.material.dataset.tasks
        actions = {references.constant_action for references in tasks.references}
        return np.array(actions.pop(), np.float32) if len(actions) == 1 and any(actions) else None

    def _references(
        self, block: Block, rows: Sequence[int], constant: NDArray[np.float32] | None
    ) -> list[Score]:
        material = self.trained.material
        family = material.family
        size, low, high = family.action_size, family.action_low, family.action_high
        zero = self._score(block, ZERO, rows, ZeroPolicy(size))
        scores = zero + self._score(block, RANDOM, rows, UniformPolicy(size, low, high))
        names = [task.name for task in material.tasks(rows)]
        if constant is None:
            scores += not_measured(block, CONSTANT, names)
        elif not constant.any():
            scores += [msgspec.structs.replace(score, method=CONSTANT) for score in zero]
        else:
            scores += self._score(block, CONSTANT, rows, ConstantPolicy(constant))
        experts = self._stored("expert", rows)
        return scores + expert_scores(block, names, experts, self._means("random", rows))
