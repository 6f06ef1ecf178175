"""Named runs as functions: the only home of chosen numbers.

    smoke   seconds; an untrained tiny language model; shows that every part works
    demo    minutes on 2 cores; two tasks of a cheetah
    base    half an hour on 2 cores for ten Meta-World tasks; the default
    paper   the published hyper-parameters (Zheng et al. 2024, review text), as far as public

Every number can be overridden on the command line: --multitask.steps 500.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from mpdt.data.slices.sampler import SamplerSettings
from mpdt.errors import unknown_name
from mpdt.model.backbone import BackboneSettings
from mpdt.model.policy import HeadSettings
from mpdt.model.prompts import PromptSettings
from mpdt.model.tokens import InputSettings
from mpdt.train.adapt.align import AdaptSettings
from mpdt.train.adapt.statistics import StatisticsSettings
from mpdt.train.evaluate.rollout import EvaluationSettings
from mpdt.train.fit.loop import MultitaskSettings, OptimiserSettings
from mpdt.train.fit.teacher import TeacherSettings
from mpdt.train.run.config import TrainConfig


def smoke() -> TrainConfig:
    """Every phase once, in seconds."""
    return TrainConfig(
        backbone=BackboneSettings(name="random:tiny", dtype="float32"),
        prompts=PromptSettings(length=4),
        sampler=SamplerSettings(window=5, per_task=4),
        optimiser=OptimiserSettings(warmup_steps=5),
        teacher=TeacherSettings(steps=20),
        multitask=MultitaskSettings(steps=20, log_every=5, checkpoint_every=10),
        statistics=StatisticsSettings(batches=2),
        adapt=AdaptSettings(windows=8, steps=2),
        evaluation=EvaluationSettings(episodes=2, horizon=20),
    )


def base() -> TrainConfig:
    """2 CPU cores, no GPU: the first block (0018), in bfloat16 where that is faster (0045)."""
    return TrainConfig(
        method="MPDT-E",
        backbone=BackboneSettings(depth=1),
        inputs=InputSettings(kind="trained", return_to_go="none", previous_action=False),
        head=HeadSettings(hidden=256),
        sampler=SamplerSettings(start_bias=30, tasks_per_update=10, per_task=6),
        optimiser=OptimiserSettings(schedule="cosine", warmup_steps=50),
        teacher=TeacherSettings(steps=1000),
        multitask=MultitaskSettings(steps=3000),
        adapt=AdaptSettings(starts=("cross", "infer")),
        evaluation=EvaluationSettings(episodes=5),
    )


def demo() -> TrainConfig:
    """As `base`, sized for the two tasks of cheetah_dir."""
    return msgspec.structs.replace(
        base(),
        sampler=SamplerSettings(start_bias=30, per_task=16),
        teacher=TeacherSettings(steps=200),
        multitask=MultitaskSettings(steps=400, checkpoint_every=100),
        evaluation=EvaluationSettings(episodes=10),
    )


def paper() -> TrainConfig:
    """Published where public: K 20, M 16, l 30, r 1, lr 1e-4, wd 1e-4, N(0, 1) prompts.

    Not public, hence ours: optimiser (AdamW, warm-up 10,000 and clip 0.25 as Prompt-DT),
    number of updates (Prompt-DT's 50,000), the distillation weight (0.9, MPT), adaptation
    steps and rate (PromptAlign's). Needs a GPU or days.
    """
    return TrainConfig(
        backbone=BackboneSettings(name="gpt2"),
        inputs=InputSettings(kind="frozen", return_to_go="family", return_clip=False),
        prompts=PromptSettings(length=30, rank=1, init_std=1.0),
        sampler=SamplerSettings(window=20, per_task=16),
        optimiser=OptimiserSettings(
            lr=1e-4, lr_cross=1e-4, lr_task=1e-4, lr_teacher=1e-4,
            weight_decay=1e-4, warmup_steps=10_000, clip=0.25,
        ),
        teacher=TeacherSettings(distillation="mpt", weight=0.9, steps=50_000),
        multitask=MultitaskSettings(steps=50_000, checkpoint_every=1000),
        adapt=AdaptSettings(starts=("cross",), steps=1, lr=5e-4),
        evaluation=EvaluationSettings(episodes=5),
    )  # fmt: skip


PRESETS: dict[str, Callable[[], TrainConfig]] = {
    "smoke": smoke,
    "demo": demo,
    "base": base,
    "paper": paper,
}


def get_preset(name: str) -> TrainConfig:
    """Raises: UsageError naming the nearest preset."""
    if name not in PRESETS:
        raise unknown_name("preset", name, PRESETS, where="--preset")
    return PRESETS[name]()
