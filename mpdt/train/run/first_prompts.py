"""The prompts a run will train, as its settings ask for them.

prompts.kind    decomposed    P_c o P_k: both trained, mixed with others, or P_k the teacher's
                shared, none  one for all tasks, or nothing
                demonstration, hyper    made from steps of the training experts
"""

from __future__ import annotations

import copy

from mpdt.errors import UsageError
from mpdt.model.demonstrations import DemonstrationPrompts, HyperPrompts
from mpdt.model.policy import PolicyBatch, PromptPolicy
from mpdt.model.prompts import DecomposedPrompts, MixedPrompts, SharedPrompt, TaughtParts
from mpdt.model.returns import ReturnTable
from mpdt.seeding import phase_seed
from mpdt.train.fit.data import Material, sample_demonstrations
from mpdt.train.fit.loop import TaskPrompts
from mpdt.train.run.config import TrainConfig


def first_prompts(
    material: Material, config: TrainConfig, policy: PromptPolicy, returns: ReturnTable
) -> TaskPrompts:
    """Prompts of the training tasks before their first update.

    Args:
        returns: one row per training task.
    Raises: UsageError for settings that exclude each other.
    """
    settings, seed = config.prompts, phase_seed(config.seed, "student")
    backbone = policy.backbone
    shape = (settings, len(material.train_rows), backbone.width, backbone.spread)
    taught = config.teacher.distillation == "parts"
    if taught and config.mixing.share:
        raise UsageError("the teacher's prompts are not trained, so they cannot be trained mixed",
                         where="mixing.share", expected="0 with --teacher.distillation parts",
                         found=str(config.mixing.share))  # fmt: skip
    if settings.kind == "decomposed":
        if taught:
            return TaughtParts(*shape, seed)
        return (MixedPrompts if config.mixing.share else DecomposedPrompts)(*shape, seed)
    if settings.kind in ("shared", "none"):
        return SharedPrompt(*shape, seed)
    inputs = copy.deepcopy(policy.inputs)
    shown = sample_demonstrations(material, settings.length, seed)
    arguments = (inputs, PolicyBatch.from_windows(shown), returns)
    if settings.kind == "hyper":
        return HyperPrompts(*arguments, backbone.num_layers, settings.rank, backbone.width, seed)
    return DemonstrationPrompts(*arguments, seed)
