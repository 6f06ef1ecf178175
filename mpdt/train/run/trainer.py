"""A run from data to table: the phases in order, each ending in a file or in the results.

    material -> [teacher prompts] -> P_c and P_k -> weights.safetensors
             -> layer statistics -> adapted prompts of the test tasks
             -> closed-loop evaluation -> results.json, report.md

The two training phases resume from checkpoints. What follows is a function of the weights and
is simply done again, after a stop or with other settings of judging.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from mpdt.data.slices.sampler import WindowSampler
from mpdt.errors import DataError
from mpdt.model.backbone import Backbone
from mpdt.model.policy import PromptPolicy
from mpdt.model.prompts import MixedPrompts, TaughtParts, TeacherPrompts
from mpdt.model.returns import ReturnTable
from mpdt.model.weights import WeightsHeader, load_weights, save_weights
from mpdt.seeding import phase_seed
from mpdt.train.fit.checkpoint import Checkpoint, Subject
from mpdt.train.fit.data import Ids, Material, return_table
from mpdt.train.fit.device import Hardware
from mpdt.train.fit.group import ALONE, Group
from mpdt.train.fit.loop import Prompts, TaskPrompts, Update, fit, make_optimizer
from mpdt.train.fit.mixing import held_out_mixtures
from mpdt.train.fit.reward import read_training_tasks
from mpdt.train.fit.teacher import Teacher
from mpdt.train.run.config import TrainConfig, to_plain
from mpdt.train.run.first_prompts import untrained_prompts
from mpdt.train.run.fit_check import check_fits
from mpdt.train.run.folder import RunFolder
from mpdt.train.run.identity import JUDGING
from mpdt.train.run.progress import Progress
from mpdt.train.run.stop import Stopped, StopRequest


@dataclass(frozen=True)
class Trained:
    """What training leaves in memory."""

    policy: PromptPolicy
    prompts: TaskPrompts
    returns: ReturnTable  # one row per training task
    steps: Mapping[str, int]  # updates done per phase
    asked: Mapping[str, int]

    @property
    def complete(self) -> bool:
        """Whether no time limit cut the training short."""
        return dict(self.steps) == dict(self.asked)


@dataclass
class Trainer:
    """The training phases of one run.

    Args:
        time_limit_s: end training after so many seconds of this process and go on with what
            there is; 0 = never. The result then depends on the machine.
        run_hash: of the training part of the run's identity; binds every file of weights.
    """

    material: Material
    config: TrainConfig
    backbone: Backbone
    folder: RunFolder
    progress: Progress
    stop: StopRequest
    time_limit_s: float = 0.0
    run_hash: str = ""
    group: Group = ALONE

    def sampler(self, phase: str, ids: Mapping[int, Ids] | None = None) -> WindowSampler:
        """Windows of the training tasks for one phase."""
        s = self.config.sampler
        return WindowSampler(
            self.material.dataset, ids or self.material.episode_ids, self.material.train_rows,
            s.window, s.per_task, phase_seed(self.config.seed, phase), s.start_bias,
            s.tasks_per_update, s.order,
        )  # fmt: skip

    def prepare(self) -> None:
        """Build all that is trained; writes nothing.

        Raises: MpdtError for settings that do not fit each other, the data or the backbone.
        """
        config, dataset = self.config, self.material.dataset
        lengths = [dataset.episodes.length, *(x.length for x in dataset.tta.values())]
        longest = max(int(length.max(initial=0)) for length in lengths)
        check_fits(self.backbone, config, max(longest, self.material.horizon))
        if config.prompts.kind == "decomposed" and len(self.material.train_rows) < 2:
            raise DataError("one training task: there is nothing to share in P_c",
                            where=str(dataset.path), expected="at least 2 training tasks",
                            hint="take the family's file, or --method Soft-Prompt")  # fmt: skip
        self.backbone.reads_adapters = config.prompts.kind == "hyper"
        stats = dataset.stats["observations"]
        self.policy = PromptPolicy(
            self.backbone, config.inputs, config.head, stats["mean"], stats["std"],
            dataset.action_size, config.seed,
        )  # fmt: skip
        self.teacher_prompts = TeacherPrompts(
            config.prompts, len(self.material.train_rows), self.backbone.width,
            self.backbone.spread, phase_seed(config.seed, "teacher"),
        )  # fmt: skip
        self.returns = return_table(
            self.material, config.inputs.return_to_go, config.target_quantile
        )
        self.prompts = untrained_prompts(self.material, config, self.policy, self.returns)
        taught = config.teacher.distillation != "none"
        self.asked = {
            "teacher": config.teacher.steps if taught else 0,
            "student": config.multitask.steps,
        }
        self._hashes = {"run": self.run_hash, "backbone": self.backbone.fingerprint}

    def train(self) -> Trained:
        """Phases A and B, from whole weights or from the checkpoints if there are any.

        A phase that a time limit cut short goes on where it stopped. A student that learnt
        from a teacher cut short begins anew, so that an unbroken run would not differ.

        Raises: Stopped after a signal, with a checkpoint written; TrainingError.
        """
        folder, began_s = self.folder, time.monotonic()
        subject = self._subject(self.prompts)
        header = self._load(folder.weights, "mpdt", subject, self.asked)
        if header is not None:
            # Lines of an earlier adaptation go: it is done again.
            folder.log.cut(int(str(header.settings["metrics_bytes"])))
            self.progress.say(f"trained already: {folder.weights}")
            return self._trained(self.asked)
        steps, teacher = {"teacher": 0, "student": 0}, None
        if self.config.teacher.distillation != "none":
            steps["teacher"] = self._train_teacher(began_s)
            if isinstance(self.prompts, TaughtParts):
                self.prompts.take(self.teacher_prompts.prompts)
            else:
                teacher = Teacher(self.policy, self.teacher_prompts, self.config.teacher)
        if isinstance(self.prompts, MixedPrompts):
            self._mix(self.prompts)
        steps["student"] = self._fit("student", subject, began_s, 1.0, teacher)
        self._save(folder.weights, "mpdt", subject, steps)
        return self._trained(steps)

    def _mix(self, prompts: MixedPrompts) -> None:
        """The held-out mixtures; a function of data and settings, so a resumed run has the same."""
        material, settings = self.material, self.config.mixing
        seed = phase_seed(self.config.seed, "mixing")

        def on_step(done: int, loss: float) -> None:
            self.stop.check()
            self.progress.update(
                "reward model", done, settings.model.steps, f"unexplained {loss:.5f}"
            )

        mixtures = held_out_mixtures(read_training_tasks(material), settings, seed, on_step)
        prompts.mix(mixtures, settings.share, seed)

    def _train_teacher(self, began_s: float) -> int:
        """Phase A into `self.policy` and `self.teacher_prompts`; the updates done."""
        subject, asked = self._subject(self.teacher_prompts), self.asked["teacher"]
        if self._load(self.folder.teacher, "teacher", subject, {"teacher": asked}) is not None:
            return asked
        self.folder.checkpoint("student").unlink(missing_ok=True)
        share = asked / max(1, sum(self.asked.values()))
        done = self._fit("teacher", subject, began_s, share)
        self._save(self.folder.teacher, "teacher", subject, {"teacher": done})
        return done

    def _trained(self, steps: Mapping[str, int]) -> Trained:
        return Trained(self.policy, self.prompts, self.returns, dict(steps), dict(self.asked))

    def _subject(self, prompts: Prompts) -> Subject:
        policy = self.policy
        return Subject(policy, prompts, make_optimizer(policy, prompts, self.config.optimiser))

    def _load(
        self, path: Path, kind: str, subject: Subject, asked: Mapping[str, int]
    ) -> WeightsHeader | None:
        """Weights with all the updates `asked`, into `subject`; None if there are none."""
        if not path.exists():
            return None
        header, tensors = load_weights(path, kind=kind, hashes=self._hashes)
        if header.settings["updates"] != dict(asked):
            return None
        subject.load(tensors)
        return header

    def _save(self, path: Path, kind: str, subject: Subject, updates: dict[str, int]) -> None:
        """Weights of a phase; its checkpoint goes once there is nothing to continue."""
        header = WeightsHeader(
            kind=kind,
            hashes=self._hashes | {"data": self.material.dataset.content_hash},
            settings={
                "updates": updates,
                "metrics_bytes": self.folder.log.size_bytes,
                "config": {k: v for k, v in to_plain(self.config).items() if k not in JUDGING},
            },
        )
        save_weights(path, subject.tensors(optimizer=False), header)
        for phase in updates:
            if updates[phase] == self.asked[phase]:
                self.folder.checkpoint(phase).unlink(missing_ok=True)

    def _fit(
        self,
        phase: str,
        subject: Subject,
        began_s: float,
        share: float,
        teacher: Teacher | None = None,
    ) -> int:
        """One training phase with its log, checkpoints, stop and share of the time limit."""
        config, log, num_steps = self.config, self.folder.log, self.asked[phase]
        checkpoint = Checkpoint(self.folder.checkpoint(phase), self._hashes, log)
        first = checkpoint.resume(phase, subject)
        if first:
            self.progress.say(f"resuming {phase} after {first} of {num_steps} updates")

        def on_step(done: int, parts: dict[str, float]) -> bool:
            late = 0 < self.time_limit_s * share < time.monotonic() - began_s
            late, asked = self.group.any([late, self.stop.signal_number is not None])
            self.stop.heed(asked)
            record: dict[str, Any] = {"phase": phase, "step": done, **parts}
            regular = done % config.multitask.log_every == 0 or done == num_steps
            if regular:
                log.append(record | prompt_norms(subject.prompts))
            text = f"action loss {parts['action_loss']:.4f}"
            if "distillation_loss" in parts:
                text += f"  distillation {parts['distillation_loss']:.4f}"
            self.progress.update(phase, done, num_steps, text)
            try:
                self.stop.check()
            except Stopped:
                checkpoint.save(phase, done, subject)
                raise
            if late or done % config.multitask.checkpoint_every == 0:
                checkpoint.save(phase, done, subject)
            if late and not regular:
                # After the checkpoint: whoever continues there forgets the extra line.
                log.append(record | prompt_norms(subject.prompts))
            return late

        hardware = Hardware(config.hardware, self.group)
        parts = [subject.policy, subject.prompts, *([teacher] if teacher else [])]
        sampler = self.sampler(phase)
        with hardware.working(self.backbone, subject.optimizer, *parts):
            update = Update(
                subject.policy, subject.prompts, hardware.returns(self.returns), sampler.seed,
                teacher, config.multitask.sparse, hardware,
            )  # fmt: skip
            return fit(update, sampler, subject.optimizer, config.optimiser,
                       range(first, num_steps), on_step)  # fmt: skip


def prompt_norms(prompts: Prompts) -> dict[str, float]:
    """Root mean squares of the parts: P_c o P_k has one scale too many, so log them apart."""
    return {
        f"rms_{name}": float(value.detach().square().mean().sqrt())
        for name, value in prompts.named_parameters()
    }


def count_trainables(trained: Trained) -> int:
    """Numbers that were trained: prompts, time table, head and, where it trains, the map."""
    modules: list[torch.nn.Module] = [trained.policy, trained.prompts]
    return sum(p.numel() for m in modules for p in m.parameters() if p.requires_grad)
