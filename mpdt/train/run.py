"""A run from data to table: the phases in order, each ending in a file or in the results.

    material -> [teacher prompts] -> P_c and P_k -> weights.safetensors
             -> layer statistics -> adapted prompts of the test tasks
             -> closed-loop evaluation -> results.json, report.md

The two training phases resume from checkpoints. What follows is a function of the weights and
is simply done again after a stop.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from mpdt.data.slices.sampler import WindowSampler
from mpdt.model.backbone import Backbone
from mpdt.model.policy import PromptPolicy
from mpdt.model.prompts import DecomposedPrompts, TeacherPrompts
from mpdt.model.returns import ReturnTable
from mpdt.model.weights import WeightsHeader, load_weights, save_weights
from mpdt.train.config import TrainConfig, to_plain
from mpdt.train.folder import RunFolder
from mpdt.train.material import Ids, Material, return_table
from mpdt.train.multitask import Prompts, fit, make_optimizer
from mpdt.train.progress import Progress
from mpdt.train.state import Checkpoint, Stopped, StopRequest, Subject
from mpdt.train.teacher import Teacher

PHASES = ("teacher", "student", "statistics", "adapt")


def phase_seed(seed: int, phase: str) -> int:
    """Independent batches for each phase: SeedSequence(seed, spawn_key=(number of phase,))."""
    words = np.random.SeedSequence(seed, spawn_key=(PHASES.index(phase),))
    return int(words.generate_state(1, np.uint32)[0])


@dataclass(frozen=True)
class Trained:
    """What training leaves in memory."""

    policy: PromptPolicy
    prompts: DecomposedPrompts
    returns: ReturnTable  # one row per training task
    steps: Mapping[str, int]  # updates done per phase


@dataclass
class Trainer:
    """The training phases of one run.

    Args:
        time_limit_s: end training after so many seconds of this process and go on with what
            there is; 0 = never. The result then depends on the machine.
    """

    material: Material
    config: TrainConfig
    backbone: Backbone
    folder: RunFolder
    progress: Progress
    stop: StopRequest
    time_limit_s: float = 0.0

    def sampler(self, phase: str, ids: Mapping[int, Ids] | None = None) -> WindowSampler:
        """Windows of the training tasks for one phase."""
        s = self.config.sampler
        return WindowSampler(
            self.material.dataset, ids or self.material.episode_ids, self.material.train_rows,
            s.window, s.per_task, phase_seed(self.config.seed, phase), s.start_bias,
            s.tasks_per_update, s.order,
        )  # fmt: skip

    def train(self) -> Trained:
        """Phases A and B, from the checkpoint if there is one.

        Raises: Stopped after a signal, with a checkpoint written; TrainingError.
        """
        config, dataset = self.config, self.material.dataset
        stats = dataset.stats["observations"]
        policy = PromptPolicy(
            self.backbone, config.inputs, config.head, stats["mean"], stats["std"],
            dataset.action_size, config.seed,
        )  # fmt: skip
        returns = return_table(self.material, config.inputs.return_to_go, config.target_quantile)
        spread = float(self.backbone.word_embeddings.std())
        shape = (config.prompts, len(self.material.train_rows), self.backbone.width, spread)
        hashes = {"run": self.folder.identity, "backbone": self.backbone.fingerprint}
        began_s, steps = time.monotonic(), {"teacher": 0, "student": 0}
        teacher = None
        if config.teacher.distillation != "none":
            prompts = TeacherPrompts(*shape, phase_seed(config.seed, "teacher"))
            subject = self._subject(policy, prompts)
            if self.folder.teacher.exists():
                header, tensors = load_weights(self.folder.teacher, kind="teacher", hashes=hashes)
                subject.load(tensors)
                steps["teacher"] = int(str(header.settings["updates"]))
            else:
                share = config.teacher.steps / max(1, config.teacher.steps + config.multitask.steps)
                steps["teacher"] = self._fit(
                    "teacher", subject, returns, hashes, config.teacher.steps, began_s, share
                )
                facts: dict[str, object] = {"updates": steps["teacher"]}
                header = WeightsHeader(kind="teacher", hashes=hashes, settings=facts)
                save_weights(self.folder.teacher, subject.tensors(optimizer=False), header)
            teacher = Teacher(policy, prompts, config.teacher)
        student = DecomposedPrompts(*shape, phase_seed(config.seed, "student"))
        subject = self._subject(policy, student)
        steps["student"] = self._fit(
            "student", subject, returns, hashes, config.multitask.steps, began_s, 1.0, teacher
        )
        save_weights(
            self.folder.weights, subject.tensors(optimizer=False),
            WeightsHeader(kind="mpdt", hashes=hashes | {"data": dataset.content_hash},
                          settings=to_plain(config)),
        )  # fmt: skip
        return Trained(policy, student, returns, steps)

    def _subject(self, policy: PromptPolicy, prompts: Prompts) -> Subject:
        return Subject(policy, prompts, make_optimizer(policy, prompts, self.config.optimiser))

    def _fit(
        self,
        phase: str,
        subject: Subject,
        returns: ReturnTable,
        hashes: dict[str, str],
        num_steps: int,
        began_s: float,
        share: float,
        teacher: Teacher | None = None,
    ) -> int:
        """One training phase with its log, checkpoints, stop and time limit."""
        config, log = self.config, self.folder.log
        checkpoint = Checkpoint(self.folder.checkpoint, hashes, log)
        first = checkpoint.resume(phase, subject)
        if first:
            self.progress.say(f"resuming {phase} after {first} of {num_steps} updates")

        def on_step(done: int, parts: dict[str, float]) -> bool:
            late = time.monotonic() - began_s > self.time_limit_s * share
            late = late and self.time_limit_s > 0
            if done % config.multitask.log_every == 0 or done == num_steps or late:
                record: dict[str, Any] = {"phase": phase, "step": done, **parts}
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
            if done % config.multitask.checkpoint_every == 0:
                checkpoint.save(phase, done, subject)
            return late

        done = fit(
            subject.policy, subject.prompts, subject.optimizer, self.sampler(phase), returns,
            config.optimiser, first_step=first, num_steps=num_steps, on_step=on_step,
            teacher=teacher, distillation_weight=config.teacher.weight,
            sparse=config.multitask.sparse,
        )  # fmt: skip
        checkpoint.save(phase, done, subject)
        return done


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
