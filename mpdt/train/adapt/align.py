"""Zero-shot adaptation on X: tune a prompt until the features look like those of training.

The published protocol. Ours, which reads X's rewards as well, is in `infer.py`; the two meet
only where a start asks for `infer`.

    X          random-action episodes of the unseen task, a preset return, no labels
    loss       L1 between per-layer mean and variance of X's features and the source's
    tuned      P_c alone (`cross_random`: v and u), its own copy for every test task
    fixed      backbone, time table, head, every P_k

All test tasks are adapted side by side. They share nothing: the loss is a sum over tasks and
AdamW works element by element, so each ends where it would have ended alone.
Source: Samadh et al. 2023 (PromptAlign), equations 5 to 7, without the entropy term. Their code
averages over channels where the paper sums; a constant factor, which AdamW does not see.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mpdt.data.slices.windows import (
    EpisodeColumns,
    StepColumns,
    WindowBatch,
    constant_returns,
    cover,
    decreasing_returns,
    gather_windows,
)
from mpdt.data.store.reader import Dataset, open_tta_rewards
from mpdt.data.store.tables import Float32
from mpdt.data.store.ttaset import find_tta_set
from mpdt.errors import DataError, TrainingError, UsageError, check_at_least, quoted
from mpdt.model.policy import PolicyBatch, PromptPolicy
from mpdt.model.prompts import UNTUNED, AdaptedPrompts, Start, TrainedPrompts
from mpdt.model.returns import ReturnTable
from mpdt.seeding import generator_at
from mpdt.train.adapt.infer import InferSettings
from mpdt.train.adapt.statistics import LayerStatistics, moments
from mpdt.train.adapt.trials.settings import TrialSettings

NOT_ADAPTED: Start = "none"
INFERRED: tuple[Start, ...] = ("infer", "infer_aligned")
LABELS: dict[Start, str] = {
    "cross": "from cross, adapted",
    "cross_mean": "from cross_mean, adapted",
    "cross_one": "from cross_one, adapted",
    "cross_random": "from cross_random, adapted",
    "infer": "infer",
    "infer_aligned": "infer, adapted",
    "none": "P_c o mean P_k, not adapted",
}
"""What the rows of each start are called."""
TRIALS: Literal["trials"] = "trials"
Way = Literal[Start, "trials"]
"""What can be done for an unseen task: tune or infer a prompt from a start, or let it try."""


class AdaptSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Test-time adaptation. Choose these on held-out training tasks, never on test returns."""

    starts: tuple[Way, ...] = ("cross",)
    """Starts to adapt from and report; P_c o mean P_k without adaptation is always reported.
    `infer` and `infer_aligned` read the rewards of X; `trials` acts in the simulator before it is
    judged."""
    trials: TrialSettings = TrialSettings()
    infer: InferSettings = InferSettings()
    set: str = "default"
    """Name of the TTA set."""
    episodes: int = 0
    """Episodes of X per task: the first n of the set; 0 = all."""
    windows: int = 64
    """Windows of X per step and task."""
    steps: int = 10
    """AdamW steps; PromptAlign takes 1."""
    lr: float = 5e-4
    """Learning rate of the prompt; PromptAlign's."""
    layers: tuple[int, ...] = ()
    """Blocks that are compared, from 0; empty = all."""
    returns: Literal["constant", "decrement"] = "constant"
    """Return-to-go in X: the preset at every step, or less the simulated rewards (reads them)."""
    clip_actions: bool = True
    """Show X's actions as the simulator executed them, or as they were drawn (up to +-3)."""
    target: Literal["preset", "training"] = "preset"
    """Return asked of test tasks: the set's preset, or the mean target of the training tasks."""

    def __post_init__(self) -> None:
        for name, least in (("episodes", 0), ("windows", 1), ("steps", 0), ("lr", 0)):
            check_at_least(f"adapt.{name}", getattr(self, name), least)

    @property
    def needs_set(self) -> bool:
        return self.infers or any(start not in (NOT_ADAPTED, TRIALS) for start in self.starts)

    @property
    def aligns(self) -> bool:
        """Whether any start is tuned, and so compared with layer statistics."""
        return any(start not in (*UNTUNED, TRIALS) for start in self.starts)

    @property
    def infers(self) -> bool:
        """Whether any start reads the rewards of X to find out the task."""
        return any(start in INFERRED for start in self.starts) or (
            self.tries and "with_x" in self.trials.rows
        )

    @property
    def explains(self) -> bool:
        """Whether a model is made of the training tasks' random episodes, to tell tasks by."""
        trials = self.trials
        return self.infers or (self.tries and trials.infer == "rewards" and "alone" in trials.rows)

    @property
    def tries(self) -> bool:
        """Whether the tasks get own episodes before they are judged."""
        return TRIALS in self.starts


@dataclass(frozen=True)
class _Source:
    steps: StepColumns
    episodes: EpisodeColumns


class AdaptationSet:
    """X of several test tasks, cut into windows that hold every step once.

    Attributes:
        source, ids: the set, and the episodes of each task in it; no rewards among them.
    Raises: UsageError for an unknown set, DataError for a task without episodes in it or with fewer
        than are asked for, and for an episode with what is no number.
    """

    def __init__(
        self,
        dataset: Dataset,
        rows: Sequence[int],
        settings: AdaptSettings,
        window: int,
        seed: int,
        low: float,
        high: float,
    ) -> None:
        self._settings, self._window, self._seed = settings, window, seed
        self._low, self._high = low, high
        self._dataset, self._set = dataset, find_tta_set(
            dataset, settings.set, rows, settings.episodes
        )  # fmt: skip
        self._rows = np.asarray(rows, np.int64)
        # A TtaSet holds step arrays and episode columns side by side.
        self.source = _Source(self._set, self._set)
        preset = self._set.preset_return
        self.ids = [self._set.of_task(row, settings.episodes or None) for row in rows]
        self._covers = [cover(self._set.length, of_task, window) for of_task in self.ids]
        self.presets = [float(preset[of_task[0]]) for of_task in self.ids]
        self.num_steps = int(self._set.length[np.concatenate(self.ids)].sum())
        for values in (self._set.observations, self._set.actions, preset):
            self._expect_numbers(values)
        if settings.returns == "decrement":
            self._returns = decreasing_returns(self.source, preset, self.rewards())
        else:
            self._returns = constant_returns(preset)

    def rewards(self) -> Float32:
        """What the simulator said of every step of the set (N,), for protocols that read it.

        Raises: DataError for an episode with what is no number; as `open_tta_rewards`.
        """
        rewards, _ = open_tta_rewards(self._dataset, self._settings.set)
        self._expect_numbers(rewards)
        return rewards

    def _expect_numbers(self, values: NDArray[Any]) -> None:
        """Raises: DataError for a step or episode of the tasks with what is no number."""
        starts = {len(self._set.observations): self._set.obs_start,
                  len(self._set.actions): self._set.start}  # fmt: skip
        bad = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
        if len(values) in starts:
            bad = np.searchsorted(starts[len(values)], bad, side="right") - 1
        if len(odd := np.intersect1d(bad, np.concatenate(self.ids))):
            raise DataError(f"episode {odd[0]} of the TTA set '{self._set.name}' has what is no "
                            "number", where=str(self._dataset.path),
                            hint=f"mpdt-data tta {quoted(self._dataset.path)} --name "
                                 f"{quoted(self._set.name)} --overwrite makes it again"
                            )  # fmt: skip

    def batch(self, step: int) -> WindowBatch:
        """Windows (n, M, K, ...) of adaptation step `step`: a pure function of (seed, step)."""
        generator = generator_at(self._seed, step)
        M = self._settings.windows
        picks = [
            generator.choice(len(ids), size=M, replace=len(ids) < M) for ids, _ in self._covers
        ]
        covers = list(zip(self._covers, picks, strict=True))
        batch = gather_windows(
            self.source,
            np.stack([ids[pick] for (ids, _), pick in covers]),
            np.stack([starts[pick] for (_, starts), pick in covers]),
            self._window, self._returns, tasks=self._rows,
        )  # fmt: skip
        if not self._settings.clip_actions:
            return batch
        return replace(
            batch,
            actions=batch.actions.clip(self._low, self._high),
            previous_actions=batch.previous_actions.clip(self._low, self._high),
        )


def returns_of_test_tasks(
    trained: ReturnTable, settings: AdaptSettings, presets: list[float]
) -> ReturnTable:
    """Scale and range of the training tasks, with the target the user asks of each test task."""
    if settings.target == "training":
        presets = [float(trained.target.mean())] * len(presets)
    return trained.pooled(presets)


def alignment_loss(
    features: tuple[Tensor, ...],
    mask: Tensor,
    source: LayerStatistics,
    axes: Literal["channel", "position"],
    layers: Sequence[int],
) -> Tensor:
    """L_align per task (n,): mean over layers and channels of |mean - mean'| + |var - var'|."""
    chosen = list(layers) or list(range(len(features)))
    mean, variance = moments(tuple(features[layer] for layer in chosen), mask, axes)
    away = (mean - source.mean[chosen]).abs() + (variance - source.variance[chosen]).abs()
    return away.flatten(start_dim=1).mean(dim=1)


def adapt(
    policy: PromptPolicy,
    trained: TrainedPrompts,
    start: Start,
    x: AdaptationSet,
    returns: ReturnTable,
    source: LayerStatistics | None,
    settings: AdaptSettings,
    axes: Literal["channel", "position"],
    seed: int,
    on_step: Callable[[int, list[float]], None] | None = None,
    weights: Tensor | None = None,
) -> Tensor:
    """Prompts (n, l, s) of the test tasks, adapted from `start`; `trained` is not changed.

    Args:
        returns: n rows, as `returns_of_test_tasks` gives them.
        source: None only for starts that tune nothing.
        on_step: called with (step, loss of each task) before each step's update.
        weights: (n, N) of the training tasks, for `infer` and `infer_aligned`; `cross_one`
            draws a donor by seed unless it is given one.
    Raises: UsageError for a layer that is not there; TrainingError if a loss is not finite.
    """
    num_layers = policy.backbone.num_layers
    if any(not 0 <= layer < num_layers for layer in settings.layers):
        raise UsageError("no such layer", where="adapt.layers", expected=f"0 to {num_layers - 1}",
                         found=str(settings.layers))  # fmt: skip
    n = len(returns)
    if start == "cross_one" and weights is None:
        generator = generator_at(seed, n)
        num_tasks = len(trained.task_parts())
        donors = torch.from_numpy(generator.integers(num_tasks, size=n))
        weights = torch.nn.functional.one_hot(donors, num_tasks).to(torch.float32)
    prompts = AdaptedPrompts(trained, start, n, weights, seed)
    tuned = [parameter for parameter in prompts.parameters() if parameter.requires_grad]
    if not tuned:
        return prompts.task_prompts().detach()
    assert source is not None
    optimizer = torch.optim.AdamW(tuned, lr=settings.lr, weight_decay=0.0)
    for step in range(settings.steps):
        windows = x.batch(step)
        batch = PolicyBatch.from_windows(windows)
        output = policy(batch, prompts.task_prompts(), returns, layer_features=True)
        losses = alignment_loss(output.features, batch.mask, source, axes, settings.layers)
        broken = ~losses.detach().isfinite()
        if broken.any():
            raise TrainingError(
                f"the alignment loss is {losses[broken][0].item()} at step {step}",
                where=f"adaptation from {start}",
                found=f"tasks {windows.tasks[broken.numpy()].tolist()}",
                hint="lower --adapt.lr, or look for broken rows with mpdt-data verify",
            )
        if on_step:
            on_step(step, losses.tolist())
        for parameter, gradient in zip(
            tuned, torch.autograd.grad(losses.sum(), tuned), strict=True
        ):
            parameter.grad = gradient
        optimizer.step()
    return prompts.task_prompts().detach()
