"""Policies for the test tasks: every start of adaptation, few-shot, and no adaptation at all.

Candidate = a label, a controller, and what was read of the test task to make it
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np
import torch
from torch import Tensor

from mpdt.data.episode import Episode
from mpdt.data.slices.sampler import SamplerSettings, WindowSampler
from mpdt.errors import UsageError
from mpdt.model.demonstrations import DemonstrationPrompts
from mpdt.model.policy import PolicyBatch, PromptPolicy, action_loss
from mpdt.model.prompts import UNTUNED, AdaptedPrompts, PromptSettings, Start
from mpdt.model.returns import ReturnTable
from mpdt.seeding import phase_seed
from mpdt.train.adapt.align import (
    INFERRED,
    LABELS,
    NOT_ADAPTED,
    TRIALS,
    AdaptationSet,
    AdaptSettings,
    adapt,
    returns_of_test_tasks,
)
from mpdt.train.adapt.few_shot import FewShotSettings, choose_steps, tune
from mpdt.train.adapt.infer import MODELS, Explanation, explain_all
from mpdt.train.adapt.statistics import LayerStatistics, StatisticsSettings, source_statistics
from mpdt.train.adapt.trials.protocol import trial_results
from mpdt.train.evaluate.controller import PerTaskController, PromptController, TrainedActor
from mpdt.train.evaluate.rollout import EvaluationSettings
from mpdt.train.evaluate.score import Reads
from mpdt.train.fit.data import Ids, sample_demonstrations
from mpdt.train.fit.reward import read_training_tasks, read_transitions
from mpdt.train.fit.trained import Trained

DONOR_BATCHES = 4  # of all training tasks, to choose the one whose demonstration stands for all


@dataclass(frozen=True)
class Candidate:
    """One row of the table of test tasks.

    Attributes:
        name: in one word; a start has its own.
        prompts: (n, l, s) the trained policy acts behind; None: a network for each task instead.
        tried: own episodes that it read, task by task.
        own_steps: their steps, of each task; empty where there are none.
    """

    name: str
    label: str
    controller: TrainedActor
    reads: Reads
    prompts: Tensor | None
    tried: tuple[Episode, ...] = ()
    own_steps: tuple[int, ...] = ()


class Settings(Protocol):
    """The parts of a run's settings that are looked at here; `TrainConfig` has them all."""

    @property
    def seed(self) -> int: ...
    @property
    def prompts(self) -> PromptSettings: ...
    @property
    def sampler(self) -> SamplerSettings: ...
    @property
    def statistics(self) -> StatisticsSettings: ...
    @property
    def adapt(self) -> AdaptSettings: ...
    @property
    def few_shot(self) -> FewShotSettings: ...
    @property
    def evaluation(self) -> EvaluationSettings: ...


OnStep = Callable[[str, int, int, str], None]
"""Called with (phase, steps done, steps in all, how it goes); raises to stop."""


def _untold(_phase: str, _done: int, _total: int, _text: str) -> None:
    pass


class Candidates:
    """The candidates of one trained policy, made one after another in the order of the table.

    Args:
        log: takes losses and inferred weights; None = nobody does.
        kept: folder in which trials are kept, to go on with after a stop; None = nowhere.
    Attributes:
        returns: what is asked of the test tasks, one row each.
    Raises: as `find_tta_set`, where the settings need that set.
    """

    def __init__(
        self, trained: Trained, settings: Settings, on_step: OnStep = _untold,
        log: list[Mapping[str, Any]] | None = None, kept: Path | None = None,
    ) -> None:  # fmt: skip
        self._kept = kept
        self._trained, self._material, self._config = trained, trained.material, settings
        self._on_step, self._log = on_step, log
        self._rows = self._material.test_rows
        self._seed = phase_seed(self._config.seed, "adapt")
        self._weights: Tensor | None = None
        self._shows = self._config.prompts.kind in ("demonstration", "hyper")
        presets = [self._material.family.return_target] * len(self._rows)
        if self._config.adapt.needs_set:
            self._x = AdaptationSet(
                self._material.dataset, self._rows, self._config.adapt,
                self._config.sampler.window, self._seed,
                self._material.family.action_low, self._material.family.action_high,
            )  # fmt: skip
            presets = self._x.presets
        self.returns = returns_of_test_tasks(trained.returns, self._config.adapt, presets)

    def __iter__(self) -> Iterator[Candidate]:
        """Adapted, few-shot, not adapted. Raises: DataError; whatever `on_step` does."""
        settings = self._config.adapt
        source = self._statistics() if settings.aligns else None
        for start in dict.fromkeys(settings.starts):
            if start == TRIALS:
                yield from self._tried()
            elif start != NOT_ADAPTED:
                reads: Reads = "X+rewards" if settings.returns == "decrement" else "X"
                reads = "X+rewards" if start in INFERRED else reads
                prompts = self._adapt(start, source)
                yield self._candidate(start, LABELS[start], prompts, reads)
        yield from self._few_shot()
        if self._config.few_shot.demonstration:
            yield self._demonstrated()
        label = LABELS[NOT_ADAPTED]
        if self._config.prompts.kind != "decomposed":
            label = "not adapted"
        prompts = self._start(NOT_ADAPTED).task_prompts().detach()
        yield self._candidate(NOT_ADAPTED, label, prompts, "nothing")

    def _candidate(self, name: str, label: str, prompts: Tensor, reads: Reads) -> Candidate:
        return Candidate(name, label, self.controller(prompts, self.returns), reads, prompts)

    def own(self) -> PromptController:
        """The training tasks, each behind its own prompt."""
        with torch.no_grad():
            prompts = self._trained.prompts.task_prompts()
        return self.controller(prompts, self._trained.returns)

    def controller(
        self, prompts: Tensor, returns: ReturnTable, policy: PromptPolicy | None = None
    ) -> PromptController:
        """The trained policy, or one tuned from it, behind these prompts."""
        family = self._material.family
        return PromptController(
            policy or self._trained.policy, prompts, returns, self._config.sampler.window,
            family.action_low, family.action_high,
        )  # fmt: skip

    def _adapt(self, start: Start, source: LayerStatistics | None) -> Tensor:
        settings = self._config.adapt

        def on_step(step: int, losses: list[float]) -> None:
            self._note({"phase": "adapt", "start": start, "step": step, "losses": losses})
            self._on_step(f"adapt {start}", step + 1, settings.steps,
                          f"alignment {sum(losses) / len(losses):.4f}")  # fmt: skip

        weights = None
        if start in INFERRED:
            weights = self.inferred()
        elif start == "cross_one" and self._shows:
            weights = self._best_donors()
        return adapt(
            self._trained.policy, self._trained.prompts, start, self._x, self.returns, source,
            settings, self._config.statistics.axes, self._seed, on_step, weights,
        )  # fmt: skip

    def _start(self, start: Start) -> AdaptedPrompts:
        trained, weights = self._trained.prompts, None
        if start in INFERRED:
            weights = self.inferred()
        elif start in UNTUNED and self._shows:
            start, weights = "infer", self._best_donors()  # demonstrations do not average
        return AdaptedPrompts(trained, start, len(self._rows), weights, self._seed)

    def _tried(self) -> Iterator[Candidate]:
        """After own episodes: a row for each K and each thing that may be read beside them."""
        config = self._config
        x = self._x if config.adapt.needs_set else None
        for one in trial_results(
            self._trained, config.adapt, self.returns, config.sampler.window,
            config.evaluation.horizon or self._material.horizon, config.seed, x, self.inferred,
            self._on_step, self._kept,
        ):  # fmt: skip
            yield Candidate(one.name, one.label, one.controller, one.reads, one.prompts,
                            one.episodes, one.own_steps)  # fmt: skip

    def _few_shot(self) -> Iterator[Candidate]:
        settings = self._config.few_shot
        for quality in settings.qualities:
            labelled = choose_steps(
                self._material.dataset, self._rows, quality, settings.steps, self._seed
            )

            def on_step(done: int, parts: dict[str, float], quality: str = quality) -> None:
                self._on_step(f"few-shot {quality}", done, settings.updates,
                              f"action loss {parts['action_loss']:.4f}")  # fmt: skip

            if settings.demonstration:
                weights = torch.eye(len(self._rows))
                own = self._demonstrations()
                start = AdaptedPrompts(own, "cross_one", len(self._rows), weights)
            else:
                start = self._start(settings.start)
            tuned = tune(
                self._trained.policy, start, labelled, self._rows,
                self._config.sampler.window, self.returns, settings, self._seed, on_step,
            )  # fmt: skip
            controllers = [
                self.controller(prompt, self.returns.select(torch.tensor([i])), policy)
                for i, (policy, prompt) in enumerate(tuned)
            ]
            reads: Reads = "demonstration" if settings.demonstration else "labelled steps"
            shared = settings.tuned == "prompt"
            yield Candidate(
                f"few_shot_{quality}", f"few-shot {quality}", PerTaskController(controllers),
                reads, torch.cat([prompt for _, prompt in tuned]) if shared else None,
            )  # fmt: skip

    def _demonstrated(self) -> Candidate:
        """An expert episode's steps of the test task itself: Prompt-DT's few-shot setting."""
        prompts = self._demonstrations().task_prompts().detach()
        return self._candidate("demonstration", "expert demonstration", prompts, "demonstration")

    def _demonstrations(self) -> DemonstrationPrompts:
        trained = self._trained.prompts
        if not isinstance(trained, DemonstrationPrompts):
            raise UsageError("only prompts made from demonstrations can show one",
                             where="few_shot.demonstration",
                             found=f"prompts.kind {self._config.prompts.kind}")  # fmt: skip
        shown = sample_demonstrations(
            self._material, self._config.prompts.length, self._seed, self._rows
        )
        return trained.showing(PolicyBatch.from_windows(shown), self.returns)

    def inferred(self) -> Tensor:
        """Weights (n, N) of the training tasks, from X and its rewards; computed once."""
        if self._weights is None:
            found = self._explanations()
            names = [self._material.dataset.tasks.names[row] for row in self._material.train_rows]
            for row, own in zip(self._rows, found, strict=True):
                self._note({"phase": "infer", "task": self._material.dataset.tasks.names[row],
                            "by": self._config.adapt.infer.by, "weights": own.named(names),
                            "error": float(own.errors.min())})  # fmt: skip
            stacked = np.stack([own.weights for own in found])
            self._weights = torch.from_numpy(stacked).to(torch.float32)
        return self._weights

    def _explanations(self) -> list[Explanation]:
        """The only place of an adaptation where rewards of a test task are read."""
        material, settings = self._material, self._config.adapt.infer
        family = material.family
        box = (family.action_low, family.action_high)
        rewards = self._x.rewards()
        steps = [read_transitions(self._x.source, ids, rewards, *box) for ids in self._x.ids]

        def on_step(done: int, loss: float) -> None:
            self._on_step(MODELS[settings.by], done, settings.steps, f"unexplained {loss:.5f}")

        # Demonstrations do not average.
        most = 1 if self._shows else settings.tasks
        known = read_training_tasks(material)
        return explain_all(known, steps, settings, most, self._seed, on_step)

    def _note(self, record: Mapping[str, Any]) -> None:
        if self._log is not None:
            self._log.append(record)

    def _sampler(
        self, ids: Mapping[int, Ids] | None = None, every_task: bool = False
    ) -> WindowSampler:
        """X is covered evenly; a training sampler may show the beginning of episodes more often."""
        settings = msgspec.structs.replace(self._config.sampler, start_bias=0)
        if every_task:
            settings = msgspec.structs.replace(settings, tasks_per_update=0)
        return self._material.sampler(settings, phase_seed(self._config.seed, "statistics"), ids)

    def _statistics(self) -> LayerStatistics:
        settings = self._config.statistics
        ids = self._material.random_ids() if settings.source == "random" else None
        trained = self._trained
        return source_statistics(
            trained.policy, trained.prompts, self._sampler(ids), trained.returns, settings
        )

    @torch.no_grad()
    def _best_donors(self) -> Tensor:
        """Weights (n, N): all on the training task whose prompt imitates all of them best.

        Every training task counts the same, however many of them an update takes.
        """
        trained, sampler = self._trained, self._sampler(every_task=True)
        parts = trained.prompts.task_parts()
        losses = np.zeros(len(parts))
        for number in range(DONOR_BATCHES):
            windows = sampler.batch(number)
            batch, slots = PolicyBatch.from_windows(windows), torch.from_numpy(windows.slots)
            assert batch.actions is not None
            returns = trained.returns.select(slots)
            for k, part in enumerate(parts):
                output = trained.policy(batch, part.expand(len(slots), *part.shape), returns)
                losses[k] += float(action_loss(output.actions, batch.actions, batch.mask))
        weights = torch.zeros(len(self._rows), len(parts))
        weights[:, int(losses.argmin())] = 1
        return weights
