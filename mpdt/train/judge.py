"""After training: adapt to the test tasks, run everybody in the simulator, fill the table.

training tasks   zero, random, best constant, expert | MPDT with each task's own P*_k
test tasks       zero, random, best constant, expert | MPDT per adaptation start,
                                                       and P_c o mean P_k without adaptation

All but the expert are run here, on the same seeds. The expert is the stored one: its mean and
its episodes in the file, where the horizon is the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mpdt.model.prompts import AdaptedPrompts, Start
from mpdt.model.returns import ReturnTable
from mpdt.train.adapt import NOT_ADAPTED, AdaptationSet, adapt, unseen_returns
from mpdt.train.controller import PromptController
from mpdt.train.evaluate import (
    ConstantController,
    Controller,
    Evaluation,
    SimulatorCache,
    UniformController,
    constant_actions,
    evaluate,
)
from mpdt.train.results import (
    CONSTANT,
    RANDOM,
    ZERO,
    Block,
    Reads,
    Score,
    expert_scores,
    normalised,
    not_measured,
    scores_of,
    with_verdicts,
)
from mpdt.train.run import Trained, Trainer, phase_seed
from mpdt.train.statistics import LayerStatistics, source_statistics

METHOD = "MPDT"


@dataclass
class Judge:
    """The phases after training, on the trainer's data, settings and progress."""

    trainer: Trainer
    trained: Trained
    simulators: SimulatorCache = field(default_factory=SimulatorCache)

    def scores(self) -> list[Score]:
        """All rows of the final table. Raises: Stopped after a signal."""
        material, config = self.trainer.material, self.trainer.config
        constant = self._best_constant() if config.evaluation.constants else None
        own = self._controller(self.trained.prompts.task_prompts(), self.trained.returns)
        references = self._references("train", material.train_rows, constant)
        scores = references + self._score("train", METHOD, material.train_rows, own)
        if not material.test_rows:
            return with_verdicts(scores)
        if material.test_rows == material.train_rows:
            # The same episodes: a trivial policy is run on a task once.
            scores += [msgspec.structs.replace(score, block="test") for score in references]
        else:
            scores += self._references("test", material.test_rows, constant)
        unread: Reads = "nothing"
        for start, prompts, returns in self._adapted():
            label, reads = f"{METHOD} P_c o mean P_k, not adapted", unread
            if start != NOT_ADAPTED:
                label = f"{METHOD} from {start}, adapted"
                reads = "rewards" if config.adapt.returns == "decrement" else "steps"
            controller = self._controller(prompts, returns)
            scores += self._score("test", label, material.test_rows, controller, reads)
        return with_verdicts(scores)

    def _adapted(self) -> list[tuple[Start, Tensor, ReturnTable]]:
        """(start, prompts (n, l, s), targets) for every start asked for, then unadapted."""
        trainer, trained = self.trainer, self.trained
        settings, family = trainer.config.adapt, trainer.material.family
        rows = trainer.material.test_rows
        done: list[tuple[Start, Tensor, ReturnTable]] = []
        plain = AdaptedPrompts(trained.prompts, NOT_ADAPTED, len(rows))
        returns = unseen_returns(trained.returns, settings, [family.return_target] * len(rows))
        if settings.needs_set:
            seed = phase_seed(trainer.config.seed, "adapt")
            unseen = AdaptationSet(
                trainer.material.dataset, rows, settings, trainer.config.sampler.window, seed,
                family.action_low, family.action_high,
            )  # fmt: skip
            returns = unseen_returns(trained.returns, settings, unseen.presets)
            source = self._statistics()
            for start in dict.fromkeys(settings.starts):
                if start == NOT_ADAPTED:
                    continue

                def on_step(step: int, losses: list[float], start: Start = start) -> None:
                    trainer.stop.check()
                    trainer.folder.log.append(
                        {"phase": "adapt", "start": start, "step": step, "losses": losses}
                    )
                    trainer.progress.update(
                        f"adapt {start}", step + 1, settings.steps,
                        f"alignment {sum(losses) / len(losses):.4f}",
                    )  # fmt: skip

                prompts = adapt(
                    trained.policy, trained.prompts, start, unseen, returns, source, settings,
                    trainer.config.statistics.axes, seed, on_step,
                )  # fmt: skip
                done.append((start, prompts, returns))
        return [*done, (NOT_ADAPTED, plain.task_prompts().detach(), returns)]

    def _statistics(self) -> LayerStatistics:
        settings = self.trainer.config.statistics
        ids = self.trainer.material.random_ids() if settings.source == "random" else None
        sampler = self.trainer.sampler("statistics", ids)
        # X is covered evenly; a training sampler may show the beginning of episodes more often.
        sampler.start_bias = 0
        return source_statistics(
            self.trained.policy, self.trained.prompts, sampler, self.trained.returns, settings
        )

    def _controller(self, prompts: Tensor, returns: ReturnTable) -> PromptController:
        family = self.trainer.material.family
        return PromptController(
            self.trained.policy, prompts, returns, self.trainer.config.sampler.window,
            family.action_low, family.action_high,
        )  # fmt: skip

    def _evaluate(
        self, label: str, rows: Sequence[int], controller: Controller, episodes: int, seed: int
    ) -> Evaluation:
        material, settings = self.trainer.material, self.trainer.config.evaluation

        def on_progress(done: int, total: int) -> None:
            self.trainer.stop.check()
            if label:
                self.trainer.progress.update(label, done, total)

        with torch.no_grad():
            return evaluate(
                controller, material.family, material.tasks(rows), material.options,
                settings.horizon or material.horizon, episodes, seed, settings.max_rows,
                on_progress, self.simulators.make,
            )  # fmt: skip

    def _score(
        self,
        block: Block,
        method: str,
        rows: Sequence[int],
        controller: Controller,
        reads: Reads | None = None,
    ) -> list[Score]:
        settings = self.trainer.config.evaluation
        result = self._evaluate(
            f"{block}: {method}", rows, controller, settings.episodes, settings.seed
        )
        random, expert = self._reference("random", rows), self._reference("expert", rows)
        return scores_of(
            block, method, result.tasks, result.returns, result.successes, random, expert, reads
        )

    def _reference(self, name: str, rows: Sequence[int]) -> NDArray[np.float64]:
        """Mean returns (n,) stored in the file; nan where the horizon judged here is another."""
        column: NDArray[np.float64] = getattr(self.trainer.material.dataset.tasks, f"ref_{name}")
        horizon = self.trainer.config.evaluation.horizon
        if horizon not in (0, self.trainer.material.horizon):
            return np.full(len(rows), math.nan)
        return column[list(rows)]

    def _references(
        self, block: Block, rows: Sequence[int], constant: NDArray[np.float32] | None
    ) -> list[Score]:
        material = self.trainer.material
        family = material.family
        size, low, high = family.action_size, family.action_low, family.action_high
        zero = self._score(block, ZERO, rows, ConstantController(np.zeros(size, np.float32)))
        scores = zero + self._score(block, RANDOM, rows, UniformController(size, low, high))
        names = [task.name for task in material.tasks(rows)]
        if constant is None:
            scores += not_measured(block, CONSTANT, names)
        elif not constant.any():
            scores += [msgspec.structs.replace(score, method=CONSTANT) for score in zero]
        else:
            scores += self._score(block, CONSTANT, rows, ConstantController(constant))
        dataset = material.dataset
        ids = [dataset.select(task=row, quality="expert") for row in rows]
        return scores + expert_scores(
            block, names, self._reference("expert", rows),
            [dataset.episodes.returns[of_task] for of_task in ids],
            [dataset.episodes.success[of_task] for of_task in ids] if family.has_success else None,
            self._reference("random", rows),
        )  # fmt: skip

    def _best_constant(self) -> NDArray[np.float32]:
        """The constant action that does best on the *training* tasks, by normalised return.

        One episode per task and candidate, on seeds apart from those of the table.
        """
        rows, seed = self.trainer.material.train_rows, self.trainer.config.evaluation.seed + 1
        random, expert = self._reference("random", rows), self._reference("expert", rows)
        levels = []
        candidates = constant_actions(self.trainer.material.family.action_size)
        for i, action in enumerate(candidates):
            self.trainer.progress.update("constants", i, len(candidates))
            result = self._evaluate("", rows, ConstantController(action), 1, seed)
            means = result.returns.mean(axis=1)
            scores = zip(means, random, expert, strict=True)
            level = np.mean([normalised(*map(float, row)) for row in scores])
            # Without references of this horizon the plain mean has to do.
            levels.append(level if math.isfinite(level) else means.mean())
        self.trainer.progress.update("constants", len(candidates), len(candidates))
        best: NDArray[np.float32] = candidates[int(np.argmax(levels))]
        return best
