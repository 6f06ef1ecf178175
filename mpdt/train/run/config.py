"""TrainConfig: the parts' own settings put together, frozen.

Nothing is defined twice: each part owns its settings, this file only composes them. Numbers
that were chosen for a purpose live in presets.py.
"""

from __future__ import annotations

from typing import Any

import msgspec

from mpdt.data.slices.sampler import SamplerSettings
from mpdt.errors import SpecError
from mpdt.model.backbone import BackboneSettings
from mpdt.model.policy import HeadSettings
from mpdt.model.prompts import PromptSettings
from mpdt.model.tokens import InputSettings
from mpdt.train.adapt.align import AdaptSettings
from mpdt.train.adapt.few_shot import FewShotSettings
from mpdt.train.adapt.statistics import StatisticsSettings
from mpdt.train.evaluate.rollout import EvaluationSettings
from mpdt.train.fit.device import HardwareSettings
from mpdt.train.fit.loop import MultitaskSettings, OptimiserSettings
from mpdt.train.fit.mixing import MixingSettings
from mpdt.train.fit.teacher import TeacherSettings


class TrainConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Every setting of a run. Equal configs on equal data on one machine give equal bytes."""

    method: str = "MPDT"
    """Name in the tables; `--method` sets it together with what makes the method."""
    seed: int = 0
    """Root of all random numbers of training and adaptation."""
    quality: str = "auto"
    """Episodes to train on: random, medium, expert, history, policy, all; auto = expert or the only
    one."""
    threads: int = 1
    """Threads of torch; 0 = all cores. Another number may change the last bits.

    One is the default: on two cores two were 1.1 times as fast when idle with passive waiting,
    and 15 times slower with torch's own (spinning) waits. See docs/log.md, 2026-11-22."""
    target_quantile: float = 0.9
    """Return asked of training tasks in closed loop, as a quantile of their training episodes."""
    validation: str | None = None
    """Slice whose episodes are not trained on: their action error is reported with every
    checkpoint, without the simulator. `mpdt-data split FILE --validation 0.1` makes one."""
    patience: int = 0
    """End training once that error has not fallen for so many looks, and keep the weights of the
    best look; 0 = train to the end and keep the last. It is off: what the training's own error says
    of returns is in docs/results.md."""
    began_from: str | None = None
    """Seal of the bundle whose numbers training begins with. `--from` sets it."""
    hardware: HardwareSettings = HardwareSettings()
    backbone: BackboneSettings = BackboneSettings()
    inputs: InputSettings = InputSettings()
    head: HeadSettings = HeadSettings()
    prompts: PromptSettings = PromptSettings()
    sampler: SamplerSettings = SamplerSettings()
    optimiser: OptimiserSettings = OptimiserSettings()
    teacher: TeacherSettings = TeacherSettings()
    multitask: MultitaskSettings = MultitaskSettings()
    mixing: MixingSettings = MixingSettings()
    statistics: StatisticsSettings = StatisticsSettings()
    adapt: AdaptSettings = AdaptSettings()
    few_shot: FewShotSettings = FewShotSettings()
    evaluation: EvaluationSettings = EvaluationSettings()

    def __post_init__(self) -> None:
        for name, low, high in (("seed", 0, 2**63 - 1), ("threads", 0, 1024),
                                ("target_quantile", 0, 1), ("patience", 0, 2**31)):  # fmt: skip
            if not low <= getattr(self, name) <= high:
                raise SpecError("setting out of range", where=name,
                                expected=f"{low} to {high}",
                                found=str(getattr(self, name)))  # fmt: skip
        if self.patience and self.validation is None:
            raise SpecError("patience with nothing to look at", where="patience",
                            hint="--validation SLICE, or leave it out")  # fmt: skip
        shots, kind = self.few_shot, self.prompts.kind
        if self.adapt.tries and kind not in ("decomposed", "shared"):
            raise SpecError("trials need trained soft prompts, to act behind and to tune",
                            where=f"prompts.kind {kind}", expected="decomposed or shared",
                            found="trials among adapt.starts",
                            hint="--adapt.starts none, or --method MPDT-ones")  # fmt: skip
        if not shots.qualities:
            return
        if self.prompts.kind == "none" and shots.tuned == "prompt":
            raise SpecError("few-shot has no prompt to tune", where="prompts.kind none",
                            hint="--few-shot.tuned all --few-shot.start none")  # fmt: skip
        if shots.start == "infer_aligned" and not self.adapt.infers:
            raise SpecError("few-shot starts from an inferred task, and none is inferred",
                            where="few_shot.start", expected="infer among adapt.starts",
                            found=" ".join(self.adapt.starts),
                            hint="--adapt.starts infer")  # fmt: skip


class JudgingSettings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be set where somebody else's policy is judged."""

    evaluation: EvaluationSettings = EvaluationSettings()


def to_plain(config: TrainConfig) -> dict[str, Any]:
    """JSON values; what config.json and results.json store."""
    plain: dict[str, Any] = msgspec.to_builtins(config)
    return plain


def from_plain(plain: dict[str, Any]) -> TrainConfig:
    """Undo `to_plain`. Raises: SpecError naming the key."""
    try:
        return msgspec.convert(plain, TrainConfig)
    except msgspec.ValidationError as error:
        raise SpecError("not a training configuration", found=str(error)) from error
