"""All that a run trains, built from settings, data and backbone before its first update."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mpdt.errors import DataError
from mpdt.model.backbone import Backbone
from mpdt.model.policy import PromptPolicy
from mpdt.model.prompts import TeacherPrompts
from mpdt.model.returns import ReturnTable
from mpdt.seeding import phase_seed
from mpdt.train.fit.checkpoint import Subject
from mpdt.train.fit.data import return_table
from mpdt.train.fit.loop import Prompts, TaskPrompts, make_optimizer
from mpdt.train.fit.trained import Trained
from mpdt.train.run.first_prompts import first_prompts
from mpdt.train.run.fit_check import check_fits
from mpdt.train.run.prepare import Prepared


@dataclass(frozen=True)
class Learner:
    """What training fills with numbers, or a file of weights does.

    Attributes:
        returns: one row per training task.
        asked: updates of each phase.
        hashes: what every file of its weights is bound to.
    """

    prepared: Prepared
    policy: PromptPolicy
    teacher_prompts: TeacherPrompts
    prompts: TaskPrompts
    returns: ReturnTable
    asked: dict[str, int]
    hashes: dict[str, str]

    def subject(self, prompts: Prompts) -> Subject:
        """The policy behind these prompts, with an optimiser of their own."""
        optimizer = make_optimizer(self.policy, prompts, self.prepared.config.optimiser)
        return Subject(self.policy, prompts, optimizer)

    def trained(self, steps: Mapping[str, int]) -> Trained:
        """What there is after so many updates of each phase."""
        return Trained(
            self.policy, self.prompts, self.returns, self.prepared.material, dict(steps),
            dict(self.asked),
        )  # fmt: skip


def build(prepared: Prepared, backbone: Backbone) -> Learner:
    """Everything fresh; writes nothing.

    Raises: MpdtError for settings that do not fit each other, the data or the backbone.
    """
    config, material = prepared.config, prepared.material
    dataset = material.dataset
    lengths = [dataset.episodes.length, *(x.length for x in dataset.tta.values())]
    longest = max(int(length.max(initial=0)) for length in lengths)
    check_fits(backbone, config, max(longest, material.horizon))
    if config.prompts.kind == "decomposed" and len(material.train_rows) < 2:
        raise DataError("one training task: there is nothing to share in P_c",
                        where=str(dataset.path), expected="at least 2 training tasks",
                        hint="take the family's file, or --method Soft-Prompt")  # fmt: skip
    backbone.reads_adapters = config.prompts.kind == "hyper"
    stats = dataset.stats["observations"]
    policy = PromptPolicy(
        backbone, config.inputs, config.head, stats["mean"], stats["std"],
        dataset.action_size, config.seed,
    )  # fmt: skip
    teacher_prompts = TeacherPrompts(
        config.prompts, len(material.train_rows), backbone.width, backbone.spread,
        phase_seed(config.seed, "teacher"),
    )  # fmt: skip
    returns = return_table(material, config.inputs.return_to_go, config.target_quantile)
    prompts = first_prompts(material, config, policy, returns)
    taught = config.teacher.distillation != "none"
    asked = {
        "teacher": config.teacher.steps if taught else 0,
        "student": config.multitask.steps,
    }
    hashes = {"run": prepared.identity.hashes["training"], "backbone": backbone.fingerprint}
    return Learner(prepared, policy, teacher_prompts, prompts, returns, asked, hashes)
