"""`--from BUNDLE`: a run whose numbers begin where another policy's are.

    settings   what the policy is made of: the bundle's; how long and how fast: the preset's
    numbers    same family: all of them, statistics of the observations too, P_k by the tasks' names
               another family: what has the same shape; the rest begins anew, and is listed
    teacher    its prompts begin as the policy's own

The seal of the bundle is part of the run's identity. Returns asked and their scale are those of
the new data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec
import torch
from torch import Tensor

from mpdt.errors import DataError, UsageError
from mpdt.model.prompts import TaughtParts
from mpdt.train.bundle.build import Bundle
from mpdt.train.bundle.format import IN_CONFIG, OWN, seal
from mpdt.train.bundle.read import read_bundle, read_config
from mpdt.train.run.build import Learner
from mpdt.train.run.config import TrainConfig, from_plain

PER_TASK = ("task_v", "task_u", "parts")
"""Prompts' tensors whose first axis is the training tasks."""


@dataclass(frozen=True)
class Beginning:
    """The bundle that a run begins from.

    Args:
        seal: of its config.json, under which every byte of it is.
    """

    folder: Path
    seal: str

    @classmethod
    def at(cls, folder: Path) -> Beginning:
        """Raises: as `read_config`."""
        return cls(folder, seal(msgspec.to_builtins(read_config(folder))))

    def settings(self, preset: TrainConfig) -> TrainConfig:
        """Settings to start from, before what the command line says.

        Raises: SpecError for a bundle whose settings are not known here.
        """
        own = from_plain(dict(read_config(self.folder).training.settings))
        teacher = msgspec.structs.replace(own.teacher, steps=preset.teacher.steps)
        sampler = msgspec.structs.replace(preset.sampler, window=own.sampler.window)
        return msgspec.structs.replace(
            preset, method=own.method, backbone=own.backbone, inputs=own.inputs, head=own.head,
            prompts=own.prompts, teacher=teacher, mixing=own.mixing, sampler=sampler,
            began_from=self.seal,
        )  # fmt: skip

    def fill(self, learner: Learner) -> list[str]:
        """Put the bundle's numbers where they fit; what was taken and what was not, as lines.

        Raises: as `read_bundle`; DataError for another bundle than the identity names; UsageError
            where they do not fit and would have to.
        """
        bundle = read_bundle(self.folder)
        if seal(msgspec.to_builtins(bundle.config)) != self.seal:
            raise DataError("another bundle took its place meanwhile", where=str(self.folder))
        _check_language_model(bundle, learner)
        same = bundle.family.name == learner.prepared.material.family.name
        with torch.no_grad():
            taken, anew = _fill_policy(bundle, learner, same)
            taken += _fill_prompts(bundle, learner, anew)
            _fill_teacher(bundle, learner)
        if same and anew:
            raise UsageError(
                "the policy does not fit this run's settings", where=str(self.folder),
                found="; ".join(anew[:4]), expected="the same inputs, head and prompts",
                hint="leave out the settings that change them",
            )  # fmt: skip
        config = bundle.config
        lines = [f"begins from {config.name} ({config.family.name}, seal {self.seal[:12]}): "
                 f"{', '.join(taken) or 'nothing fits'}"]  # fmt: skip
        return [*lines, *([f"begins anew: {', '.join(anew)}"] if anew else [])]


def _check_language_model(bundle: Bundle, learner: Learner) -> None:
    facts, ours = bundle.config.backbone, learner.policy.backbone
    theirs = bundle.policy.backbone
    if (facts.fingerprint, theirs.num_layers) != (ours.fingerprint, ours.num_layers):
        raise UsageError(
            "a policy on another language model", where=bundle.config.name,
            expected=f"{ours.name}, {ours.num_layers} blocks, {ours.fingerprint[:12]}",
            found=f"{facts.name}, {theirs.num_layers} blocks, {facts.fingerprint[:12]}",
            hint="leave out --backbone settings: the bundle's are taken",
        )  # fmt: skip
    if facts.trained != "none":
        raise UsageError("its language model was trained as well, and cannot be trained on",
                         where=bundle.config.name, expected="a frozen language model",
                         found=f"method {bundle.config.training.method}")  # fmt: skip


def _fill_policy(bundle: Bundle, learner: Learner, same: bool) -> tuple[list[str], list[str]]:
    theirs, own = bundle.policy.own_state(), learner.policy.own_state()
    if not same:  # other observations, or the same ones seen otherwise
        theirs = {k: v for k, v in theirs.items() if k not in IN_CONFIG}
        own = {k: v for k, v in own.items() if k not in IN_CONFIG}
    fits = {k: v for k, v in theirs.items() if k in own and v.shape == own[k].shape}
    learner.policy.load_state_dict(fits, strict=False)
    anew = [f"{name} {tuple(own[name].shape)}" for name in own if name not in fits]
    numbers = len([name for name in fits if name not in IN_CONFIG])
    taken = [f"{numbers} of {len([k for k in own if k not in IN_CONFIG])} tensors of maps and head"]
    return taken + ["statistics"] * same, anew


def _fill_prompts(bundle: Bundle, learner: Learner, anew: list[str]) -> list[str]:
    """What was taken; what could not be is added to `anew`."""
    taken, rows = [], _rows(bundle, learner)
    own = dict(learner.prompts.named_parameters())
    if isinstance(learner.prompts, TaughtParts):
        own["parts"] = learner.prompts.parts  # type: ignore[assignment]
    for name, tensor in own.items():
        found = bundle.trained.get(name)
        if name in PER_TASK:
            if found is not None and found.shape[1:] == tensor.shape[1:]:
                _copy_rows(tensor, found, rows)
                if name != "task_u":
                    taken.append(f"P_k of {len(rows)} of {len(tensor)} tasks")
            elif found is None or rows:
                anew.append(f"prompts.{name}")
        elif found is not None and found.shape == tensor.shape:
            tensor.copy_(found)
            taken.append("P_c" if name == "cross" else f"prompts.{name}")
        else:
            anew.append(f"prompts.{name} {tuple(tensor.shape)}")
    return taken


def _fill_teacher(bundle: Bundle, learner: Learner) -> None:
    prompts, found = learner.teacher_prompts.prompts, bundle.prompts.get(OWN)
    if found is not None and found.shape[1:] == prompts.shape[1:]:
        _copy_rows(prompts, found, _rows(bundle, learner))


def _rows(bundle: Bundle, learner: Learner) -> Mapping[int, int]:
    """Training tasks here -> theirs, by name; empty for another family."""
    material = learner.prepared.material
    if bundle.family.name != material.family.name:
        return {}
    known = next((one.tasks for one in bundle.config.prompts if one.name == OWN), ())
    names = [material.dataset.tasks.names[row] for row in material.train_rows]
    return {here: known.index(name) for here, name in enumerate(names) if name in known}


def _copy_rows(target: Tensor, source: Tensor, rows: Mapping[int, int]) -> None:
    for here, there in rows.items():
        target[here] = source[there]
