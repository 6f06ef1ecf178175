"""The teacher: one full soft prompt per training task, and what the student learns from it.

    phase A   teacher prompts (N, l, s) + time table + head (+ map)   trained together
              tasks share no prompt parameter, so each prompt is tuned on its task alone
    phase B   a frozen copy of all that is the teacher; the student starts from the same
              time table and head, which go on training with P_c and P_k

Targets of the distillation loss L_dis, each free of the scale of what it compares:

    prompt   mean (P* - P^teacher)^2 / mean (P^teacher)^2
    mpt      mean (a - a^teacher)^2  +  hidden_weight * mean over layers of
             mean (H - H^teacher)^2 / mean (H^teacher - its channel mean)^2
    parts    nothing: the teacher's prompts are the P_k, frozen, and P_c alone is learned
    none     nothing; phase A is skipped

The hidden term is the share of the teacher's variance the student misses: 0 = the same
features, about 1 = no better than the mean. Raw squared errors would be ruled by the few
channels in which language models carry values in the hundreds.
Source: Wang et al. 2023 (MPT) for the form with lambda 0.9; the published method gives neither
the form nor the weight.
"""

from __future__ import annotations

import copy
from typing import Literal

import msgspec
import torch
from torch import Tensor, nn

from mpdt.errors import check_at_least
from mpdt.model.policy import PolicyBatch, PolicyOutput, PromptPolicy
from mpdt.model.prompts import TeacherPrompts
from mpdt.model.returns import ReturnTable
from mpdt.train.fit.group import ALONE, Group

Distillation = Literal["mpt", "prompt", "parts", "none"]


class TeacherSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Phase A and the distillation loss of phase B."""

    distillation: Distillation = "mpt"
    """What the student is compared with; `none` needs no teacher."""
    weight: float = 0.9
    """lambda in L_act + lambda L_dis."""
    hidden_weight: float = 0.1
    """Weight of the hidden term inside L_dis (target mpt)."""
    steps: int = 1000
    """Updates of the teacher prompts."""

    def __post_init__(self) -> None:
        for name in ("weight", "hidden_weight", "steps"):
            check_at_least(f"teacher.{name}", getattr(self, name), 0)


class Teacher(nn.Module):
    """A frozen copy of the policy after phase A with the teacher prompts.

    The backbone is shared where it is frozen anyway; where it trains it is copied too.
    """

    _prompts: Tensor

    def __init__(
        self, policy: PromptPolicy, prompts: TeacherPrompts, settings: TeacherSettings
    ) -> None:
        super().__init__()
        frozen = policy.backbone.frozen
        memo = {id(policy.backbone): policy.backbone} if frozen else {}
        self._policy = copy.deepcopy(policy, memo).requires_grad_(False)
        self.register_buffer("_prompts", prompts.prompts.detach().clone())
        self._settings = settings

    @property
    def weight(self) -> float:
        """lambda: how much L_dis counts beside the action loss."""
        return self._settings.weight

    @property
    def needs_features(self) -> bool:
        """Whether the student's forward pass has to hand out layer features."""
        return self._settings.distillation == "mpt" and self._settings.hidden_weight > 0

    def loss(
        self,
        batch: PolicyBatch,
        slots: Tensor,
        prompts: Tensor,
        output: PolicyOutput,
        returns: ReturnTable,
        group: Group = ALONE,
    ) -> Tensor:
        """L_dis of one batch.

        Args:
            slots: (n,) rows of the teacher prompts.
            prompts, output: (n, l, s) and the student's answer to the same batch.
            group: who else has windows of this batch; the teacher's variance is that of all.
        """
        target = self._prompts[slots]
        if self._settings.distillation == "prompt":
            distance: Tensor = (prompts - target).square().mean() / target.square().mean()
            return distance
        with torch.no_grad():
            taught = self._policy(batch, target, returns, layer_features=self.needs_features)
        mask = batch.mask
        loss: Tensor = (output.actions - taught.actions)[mask].square().mean()
        if self.needs_features:
            hidden = torch.stack([
                missed_variance(own[mask], theirs[mask], group)
                for own, theirs in zip(output.features, taught.features, strict=True)
            ])  # fmt: skip
            loss = loss + self._settings.hidden_weight * hidden.mean()
        return loss


def missed_variance(features: Tensor, target: Tensor, group: Group = ALONE) -> Tensor:
    """Share of the variance of `target` (T, s) that `features` (T, s) does not explain.

    target  [[0], [2]]   its variance 1      features [[0], [1]]   missed (0 + 1) / 2 = 0.5
    """
    if group.size == 1:
        spread = (target - target.mean(dim=0)).square().mean()
    else:
        rows = group.total(target.new_tensor(float(len(target))))
        mean = group.total(target.sum(dim=0)) / rows
        spread = group.total((target - mean).square().sum()) / (rows * target.shape[1])
    return (features - target).square().mean() / spread.clamp_min(1e-12)
