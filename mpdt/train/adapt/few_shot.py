"""Few-shot: a handful of labelled steps of each test task, and what is tuned on them.

    quality     expert, medium, random; mixed = a third of the steps from each
    steps       the first ones of an episode, drawn by seed; the next episode if it was short
    tuned       the start's part of the soft prompt (the published way), or every weight

Trained by the same loop as everything else. Returns-to-go count to the end of the labelled
steps: what comes after them is not known.
Source: 200 steps and the levels, Zheng et al. 2024 (rebuttal); updates and rate are ours.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mpdt.data.slices.sampler import RewardColumns, WindowSampler
from mpdt.data.store.reader import Dataset
from mpdt.errors import DataError, UsageError, check_above_zero, check_at_least
from mpdt.model.policy import PromptPolicy
from mpdt.model.prompts import UNTUNED, AdaptedPrompts, Start
from mpdt.model.returns import ReturnTable
from mpdt.seeding import generator_at
from mpdt.train.fit.loop import OptimiserSettings, Update, fit, make_optimizer

Label = Literal["expert", "medium", "random", "mixed"]
_LEVELS: dict[Label, tuple[str, ...]] = {
    "expert": ("expert",), "medium": ("medium",), "random": ("random",),
    "mixed": ("expert", "medium", "random"),
}  # fmt: skip


class FewShotSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Tuning on labelled steps of the test tasks. Choose these on held-out training tasks."""

    qualities: tuple[Label, ...] = ()
    """Kinds of labelled steps to try, each from the trained weights; empty = no few-shot."""
    demonstration: bool = False
    """Show an expert episode's steps of the test task itself (prompts of kind demonstration)."""
    steps: int = 200
    """Labelled steps per task."""
    start: Start = "cross"
    """Prompt to tune, as in `adapt.starts`; one that tunes something."""
    tuned: Literal["prompt", "all"] = "prompt"
    """The prompt, or every weight of a copy of the policy for each task."""
    updates: int = 100
    per_task: int = 16
    """Windows per update."""
    lr: float = 1e-3
    """Where every weight is tuned, held-out classes preferred 3e-4 (docs/decisions/0011)."""

    def __post_init__(self) -> None:
        for name in ("steps", "updates", "per_task"):
            check_at_least(f"few_shot.{name}", getattr(self, name), 1)
        check_above_zero("few_shot.lr", self.lr)
        if self.tuned == "prompt" and self.start in UNTUNED:
            raise UsageError("this start tunes nothing", where="few_shot.start",
                             expected="cross, cross_mean, cross_one, cross_random, infer_aligned",
                             found=self.start,
                             hint="or tune the policy: --few-shot.tuned all")  # fmt: skip


@dataclass(frozen=True)
class TrimmedEpisodes:
    start: NDArray[Any]
    obs_start: NDArray[Any]
    length: NDArray[np.int64]


@dataclass(frozen=True)
class LabelledSteps:
    """A dataset whose chosen episodes end where the labels end.

    Attributes:
        ids: per task row, the episodes with labelled steps.
    """

    steps: RewardColumns
    episodes: TrimmedEpisodes
    ids: dict[int, NDArray[np.int64]]

    def num_steps(self, row: int) -> int:
        return int(self.episodes.length[self.ids[row]].sum())


def choose_steps(
    dataset: Dataset, rows: Sequence[int], quality: Label, num_steps: int, seed: int
) -> LabelledSteps:
    """`num_steps` labelled steps of every task row; other seeds choose other episodes.

    Raises: DataError if a task has too few steps of a level.
    """
    length = np.asarray(dataset.episodes.length, np.int64).copy()
    ids: dict[int, NDArray[np.int64]] = {}
    levels = _LEVELS[quality]
    for row in rows:
        generator = generator_at(seed, row)
        chosen: list[int] = []
        for number, level in enumerate(levels):
            wanted = num_steps // len(levels) + (number < num_steps % len(levels))
            for i in generator.permutation(dataset.select(task=row, quality=level)).tolist():
                if wanted == 0:
                    break
                length[i] = min(int(length[i]), wanted)
                wanted -= int(length[i])
                chosen.append(i)
            if wanted:
                raise DataError(
                    f"too few {level} steps of test task {dataset.tasks.names[row]}",
                    where=str(dataset.path), expected=f"{num_steps} labelled steps",
                    found=f"{wanted} short", hint="lower --few-shot.steps, or take the whole file",
                )  # fmt: skip
        ids[row] = np.array(sorted(chosen), np.int64)
    trimmed = TrimmedEpisodes(dataset.episodes.start, dataset.episodes.obs_start, length)
    return LabelledSteps(cast(RewardColumns, dataset.steps), trimmed, ids)


def tune(
    policy: PromptPolicy,
    prompts: AdaptedPrompts,
    labelled: LabelledSteps,
    rows: Sequence[int],
    window: int,
    returns: ReturnTable,
    settings: FewShotSettings,
    seed: int,
    on_step: Callable[[int, dict[str, float]], None] | None = None,
) -> list[tuple[PromptPolicy, Tensor]]:
    """For every row a policy and its prompt (1, l, s). `policy` itself is not changed.

    With `prompt` the tasks are tuned side by side: they share nothing, and nothing is clipped.
    With `all` one after the other, each from the trained weights with an optimiser of its own.
    Raises: TrainingError if a loss is not a finite number.
    """
    rates = OptimiserSettings(
        lr=settings.lr, lr_cross=settings.lr, lr_task=settings.lr, lr_teacher=settings.lr,
        weight_decay=0.0, warmup_steps=0, clip=0.0,
    )  # fmt: skip

    def run(policy: PromptPolicy, prompts: AdaptedPrompts, rows: Sequence[int],
            returns: ReturnTable) -> None:  # fmt: skip
        sampler = WindowSampler(labelled, labelled.ids, rows, window, settings.per_task, seed)

        def report(done: int, parts: dict[str, float]) -> bool:
            if on_step:
                on_step(done, parts)
            return False

        update = Update(policy, prompts, returns, seed, phase="few-shot", rate="--few-shot.lr")
        fit(update, sampler, make_optimizer(policy, prompts, rates), rates,
            range(settings.updates), report)  # fmt: skip

    if settings.tuned == "prompt":
        # A frozen twin that shares every number: only gradients to the prompt are wanted.
        memo = {id(p): torch.nn.Parameter(p.data, requires_grad=False) for p in policy.parameters()}
        run(copy.deepcopy(policy, memo), prompts, rows, returns)
        tuned = prompts.task_prompts().detach()
        return [(policy, tuned[i : i + 1]) for i in range(len(rows))]
    done = []
    for i, row in enumerate(rows):
        one = torch.tensor([i])
        own, own_prompts = own_copy(policy), prompts.select(one)
        run(own, own_prompts, [row], returns.select(one))
        done.append((own, own_prompts.task_prompts().detach()))
    return done


def own_copy(policy: PromptPolicy) -> PromptPolicy:
    """A copy to be tuned; what is frozen is shared, and may be most of it."""
    memo = {id(p): p for p in policy.parameters() if not p.requires_grad}
    return copy.deepcopy(policy, memo)
