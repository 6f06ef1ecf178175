"""The training loop, one page: soft prompts of many tasks behind one frozen language model.

    for every update:                         `fit`
        windows of every training task        a pure function of (seed, step), `data/slices`
        prompts P*_k of those tasks           teacher: full ones; student: P_c o v_k u_k
        loss = L_act + lambda L_dis           `Update`; L_dis only for the student, `teacher.py`
        AdamW with warm-up and clipping       prompts, time table, head (and map)

Both phases use it (`run/trainer.py`), and few-shot tuning (`adapt/few_shot.py`). Where it is
computed is in `device.py`, by how many processes in `group.py`. Whatever changes from update to
update comes from (seed, step), so a checkpoint holds numbers and a step, and a resumed run
repeats an unbroken one bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import msgspec
import torch
from torch import Tensor, nn

from mpdt.data.slices.sampler import WindowSampler
from mpdt.data.slices.windows import WindowBatch
from mpdt.errors import TrainingError, check_at_least
from mpdt.model.demonstrations import DemonstrationPrompts
from mpdt.model.policy import PromptPolicy, action_loss
from mpdt.model.prompts import (
    AdaptedPrompts,
    DecomposedPrompts,
    SharedPrompt,
    TaughtParts,
    TeacherPrompts,
)
from mpdt.model.returns import ReturnTable
from mpdt.seeding import Beside, torch_generator_at
from mpdt.train.fit.device import PROCESSOR, Hardware
from mpdt.train.fit.teacher import Teacher

TaskPrompts = DecomposedPrompts | TaughtParts | SharedPrompt | DemonstrationPrompts
Prompts = TaskPrompts | TeacherPrompts | AdaptedPrompts
Step = Callable[[int, dict[str, float]], bool]
"""Called after every update with (updates done, losses); True ends the loop early."""


class OptimiserSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """AdamW for both phases."""

    lr: float = 1e-3
    """Learning rate of what all tasks share: time table, head, trained input map."""
    lr_cross: float = 1e-3
    """Learning rate of P_c."""
    lr_task: float = 1e-3
    """Learning rate of u_k and v_k."""
    lr_teacher: float = 1e-3
    """Learning rate of the teacher prompts."""
    weight_decay: float = 1e-4
    warmup_steps: int = 100
    """Updates over which the learning rates rise linearly from 0."""
    schedule: Literal["constant", "cosine"] = "constant"
    """After the warm-up: stay, or fall to 0 along half a cosine at the last update."""
    clip: float = 0.25
    """Largest norm of the whole gradient; 0 never clips."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            if name != "schedule":
                check_at_least(f"optimiser.{name}", getattr(self, name), 0)


class MultitaskSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Phase B, and how often both phases report."""

    steps: int = 3000
    """Updates of P_c and P_k."""
    log_every: int = 50
    """Updates between two lines of metrics.jsonl."""
    checkpoint_every: int = 500
    """Updates between two checkpoints; stopping writes one as well."""
    sparse: float = 0.0
    """lambda_1 of the mean of |P_k| (published option: 0.2)."""

    def __post_init__(self) -> None:
        for name, least in (("steps", 0), ("log_every", 1), ("checkpoint_every", 1), ("sparse", 0)):
            check_at_least(f"multitask.{name}", getattr(self, name), least)


@dataclass(frozen=True)
class Update:
    """What is trained, and the losses that say where to.

    Args:
        returns: one row per task, on the device of `hardware`.
        seed: of dropout, the sampler's; a stream of its own beside the windows.
        teacher: what the student is compared with; None for the teacher itself.
        sparse: lambda_1 of the mean of |P_k|.
        hardware: where the modules are, and who else trains them.
        phase, rate: what an error names, and the option that would help.
    """

    policy: PromptPolicy
    prompts: Prompts
    returns: ReturnTable
    seed: int
    teacher: Teacher | None = None
    sparse: float = 0.0
    hardware: Hardware = PROCESSOR
    phase: str = "training"
    rate: str = "--optimiser.lr"

    def losses(self, windows: WindowBatch, step: int) -> dict[str, Tensor]:
        """Means over the real steps of these windows: `loss`, which is descended, and its parts."""
        hardware, teacher = self.hardware, self.teacher
        batch, slots = hardware.batch(windows), hardware.tensor(torch.from_numpy(windows.slots))
        of_tasks, task_prompts = self.returns.select(slots), self.prompts.task_prompts(slots, step)
        output = self.policy(
            batch, task_prompts, of_tasks,
            generator=torch_generator_at(self.seed, step, beside=Beside.DROPOUT),
            layer_features=teacher is not None and teacher.needs_features,
        )  # fmt: skip
        assert batch.actions is not None
        loss = action = action_loss(output.actions, batch.actions, batch.mask)
        losses = {"action_loss": action}
        if teacher is not None:
            distilled = teacher.loss(batch, slots, task_prompts, output, of_tasks, hardware.group)
            loss = loss + teacher.weight * distilled
            losses["distillation_loss"] = distilled
        if self.sparse and isinstance(self.prompts, DecomposedPrompts):
            loss = loss + self.sparse * self.prompts.task_parts(slots).abs().mean()
        return losses | {"loss": loss}


def fit(
    update: Update,
    sampler: WindowSampler,
    optimizer: torch.optim.AdamW,
    settings: OptimiserSettings,
    steps: range,
    on_step: Step,
) -> int:
    """Do the updates `steps`; returns the number done, counted from the first of the phase.

    Args:
        steps: from where a checkpoint stopped to the last of the phase, where rates end.
        on_step: told the losses of all processes together.
    Raises: TrainingError with step and windows if the loss is not a finite number.
    """
    trained = [p for rates in optimizer.param_groups for p in rates["params"]]
    hardware, group = update.hardware, update.hardware.group
    for step in steps:
        for rates in optimizer.param_groups:
            rates["lr"] = rates["base_lr"] * rate_factor(settings, step, steps.stop)
        windows = group.share(sampler.batch(step))
        with hardware.autocast():
            losses = update.losses(windows, step)
        optimizer.zero_grad(set_to_none=True)
        weight = group.weight(hardware.tensor(torch.from_numpy(windows.mask)))
        hardware.scaler.scale(weight * losses["loss"]).backward()  # type: ignore[no-untyped-call]
        group.add_gradients(trained)
        hardware.scaler.unscale_(optimizer)
        norm = nn.utils.clip_grad_norm_(trained, settings.clip or math.inf)
        parts = {name: float(group.total(weight * value)) for name, value in losses.items()}
        if hardware.accepts(norm):
            parts["gradient_norm"] = norm.item()
        _stop_on_nan(parts, step, windows, update)
        hardware.scaler.step(optimizer)
        hardware.scaler.update()
        if on_step(step + 1, parts):
            return step + 1
    return steps.stop


def make_optimizer(
    policy: PromptPolicy, prompts: Prompts, settings: OptimiserSettings
) -> torch.optim.AdamW:
    """AdamW over the prompts and all trainables of the policy, each with its own rate."""
    rates = {
        "cross": settings.lr_cross, "prompts": settings.lr_teacher,
        "task_v": settings.lr_task, "task_u": settings.lr_task,
    }  # fmt: skip
    groups = [{"params": [p for p in policy.parameters() if p.requires_grad], "lr": settings.lr}]
    groups += [
        {"params": [parameter], "lr": rates.get(name, settings.lr)}
        for name, parameter in prompts.named_parameters()
    ]
    # `base_lr` travels in the group, so the schedule needs nothing but the step.
    kept = [group | {"base_lr": group["lr"]} for group in groups if group["params"]]
    return torch.optim.AdamW(kept, weight_decay=settings.weight_decay)


def rate_factor(settings: OptimiserSettings, step: int, num_steps: int) -> float:
    """Share of the full learning rate at update `step` (from 0)."""
    factor = min(1.0, (step + 1) / max(1, settings.warmup_steps))
    if settings.schedule == "cosine":
        factor *= 0.5 * (1 + math.cos(math.pi * step / num_steps))
    return factor


def _stop_on_nan(parts: dict[str, float], step: int, windows: WindowBatch, update: Update) -> None:
    broken = [name for name, value in parts.items() if not math.isfinite(value)]
    if broken:
        raise TrainingError(
            f"{broken[0]} is {parts[broken[0]]} at step {step}",
            where=update.phase,
            found=f"tasks {windows.tasks.tolist()}, episodes {windows.episodes.tolist()}, "
            f"starts {windows.starts.tolist()}",
            hint=f"lower {update.rate}, or look for broken rows with mpdt-data verify",
        )
