"""The training phases of a run, each ending in a file.

    material -> [teacher prompts] -> P_c and P_k -> weights.safetensors

Both resume from checkpoints. What follows is a function of the weights and is simply done again,
after a stop or with other settings of judging.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec

from mpdt.data.store.proof import BackgroundProof
from mpdt.errors import UsageError
from mpdt.model.prompts import MixedPrompts, TaughtParts
from mpdt.model.weights import WeightsHeader, load_weights, save_weights
from mpdt.seeding import phase_seed
from mpdt.train.fit.checkpoint import Checkpoint, Subject
from mpdt.train.fit.device import Hardware
from mpdt.train.fit.group import ALONE, Group
from mpdt.train.fit.loop import Prompts, Update, fit
from mpdt.train.fit.mixing import held_out_mixtures
from mpdt.train.fit.reward import read_training_tasks
from mpdt.train.fit.teacher import Teacher
from mpdt.train.fit.trained import Trained
from mpdt.train.fit.validation import Validation
from mpdt.train.run.build import Learner
from mpdt.train.run.config import to_plain
from mpdt.train.run.folder import RunFolder
from mpdt.train.run.follower import Follower, Nobody
from mpdt.train.run.identity import JUDGING
from mpdt.train.run.looking import Looking
from mpdt.train.run.progress import Progress
from mpdt.train.run.spent import Spent
from mpdt.train.run.stop import Stopped


@dataclass
class Trainer:
    """The training phases of one run.

    Args:
        time_limit_s: end training after so many seconds of this process and go on with what
            there is; 0 = never. The result then depends on the machine.
        proof: that what is learnt from is whole; nothing is kept before it is.
        filled: the learner holds the numbers of the bundle that the run begins from.
        follower: told of the lines that are kept.
    Attributes:
        log_bytes: of metrics.jsonl, up to the last line of the training.
    """

    learner: Learner
    folder: RunFolder
    progress: Progress
    time_limit_s: float = 0.0
    group: Group = ALONE
    proof: BackgroundProof | None = None
    filled: bool = False
    follower: Follower = field(default_factory=Nobody)
    log_bytes: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        prepared = self.learner.prepared
        self._config, self._material = prepared.config, prepared.material
        self._ended = False  # by patience, with fewer updates than were asked for

    def train(self) -> Trained:
        """Phases A and B, from whole weights or from the checkpoints if there are any.

        A phase that a time limit cut short goes on where it stopped. A student that learnt
        from a teacher cut short begins anew, so that an unbroken run would not differ.

        Raises: Stopped after a signal, with a checkpoint written; TrainingError.
        """
        learner, folder, began_s = self.learner, self.folder, time.monotonic()
        subject = learner.subject(learner.prompts)
        header = self._load(folder.weights, "mpdt", subject, learner.asked)
        if header is not None:
            self.log_bytes = int(str(header.settings["metrics_bytes"]))
            folder.log.check(self.log_bytes)
            self.follower.kept(self.log_bytes)
            self.progress.say(f"trained already: {folder.weights}")
            updates = msgspec.convert(header.settings["updates"], dict[str, int])
            if self._drop_checkpoints(updates):  # of a process that was killed just before
                folder.checkpoint("best").unlink(missing_ok=True)
            return self._trained(updates)
        with Spent(folder).training():
            steps = self._phases(subject, began_s)
        self.log_bytes = folder.log.size_bytes
        return self._trained(steps)

    def _trained(self, steps: dict[str, int]) -> Trained:
        trained = self.learner.trained(steps)
        return replace(trained, asked=steps) if self._ended else trained

    def _phases(self, subject: Subject, began_s: float) -> dict[str, int]:
        """Phases A and B and their file; the updates done."""
        learner = self.learner
        if self._config.began_from is not None and not self.filled:
            raise UsageError("this run begins from a bundle", where=str(self.folder.path),
                             expected=f"one of seal {self._config.began_from[:12]}",
                             hint="the same command as before, with its --from")  # fmt: skip
        steps, teacher = {"teacher": 0, "student": 0}, None
        if self._config.teacher.distillation != "none":
            steps["teacher"] = self._train_teacher(began_s)
            if steps["teacher"] < learner.asked["teacher"]:
                self.follower = Nobody()  # this student's lines go when the teacher goes on
            if isinstance(learner.prompts, TaughtParts):
                learner.prompts.take(learner.teacher_prompts.prompts)
            else:
                teacher = Teacher(learner.policy, learner.teacher_prompts, self._config.teacher)
        if isinstance(learner.prompts, MixedPrompts):
            self._mix(learner.prompts)
        looking = self._looking()
        steps["student"] = self._fit("student", subject, began_s, 1.0, teacher, looking)
        whole = steps["student"] == learner.asked["student"] or (looking and looking.is_over())
        if looking and looking.patience and whole:
            steps["student"], self._ended = looking.take_best(subject), True
            self.progress.say(f"the best look was after {steps['student']} updates: taken")
        self._save(self.folder.weights, "mpdt", subject, steps)
        if looking and whole:
            looking.forget()
        return steps

    def _looking(self) -> Looking | None:
        material, config = self._material, self._config
        if not material.validation_ids:
            return None
        validation = Validation(
            material, config.sampler.window, phase_seed(config.seed, "validation")
        )
        return Looking(
            validation, self.folder, self.learner.hashes, config.multitask.checkpoint_every,
            config.patience,
        )  # fmt: skip

    def _mix(self, prompts: MixedPrompts) -> None:
        """The held-out mixtures; a function of data and settings, so a resumed run has the same."""
        material, settings = self._material, self._config.mixing
        seed = phase_seed(self._config.seed, "mixing")

        def on_step(done: int, loss: float) -> None:
            self.progress.update(
                "reward model", done, settings.model.steps, f"unexplained {loss:.5f}"
            )

        mixtures = held_out_mixtures(read_training_tasks(material), settings, seed, on_step)
        prompts.mix(mixtures, settings.share, seed)

    def _train_teacher(self, began_s: float) -> int:
        """Phase A into the policy and the teacher's prompts; the updates done."""
        learner, asked = self.learner, self.learner.asked["teacher"]
        subject = learner.subject(learner.teacher_prompts)
        if self._load(self.folder.teacher, "teacher", subject, {"teacher": asked}) is not None:
            return asked
        self.folder.checkpoint("student").unlink(missing_ok=True)
        share = asked / max(1, sum(learner.asked.values()))
        done = self._fit("teacher", subject, began_s, share)
        self._save(self.folder.teacher, "teacher", subject, {"teacher": done})
        return done

    def _load(
        self, path: Path, kind: str, subject: Subject, asked: Mapping[str, int]
    ) -> WeightsHeader | None:
        """Weights with all the updates `asked`, into `subject`; None if there are none."""
        if not path.exists():
            return None
        header, tensors = load_weights(path, kind=kind, hashes=self.learner.hashes)
        self._ended = bool(header.settings.get("ended"))
        if header.settings["updates"] != dict(asked) and not self._ended:
            return None
        subject.load(tensors)
        return header

    def _save(self, path: Path, kind: str, subject: Subject, updates: dict[str, int]) -> None:
        """Weights of a phase; its checkpoint goes once there is nothing to continue.

        Raises: FormatError if an episode it may have learnt from is damaged.
        """
        self._prove()
        header = WeightsHeader(
            kind=kind,
            hashes=self.learner.hashes | {"data": self._material.dataset.content_hash},
            settings={
                "updates": updates,
                "metrics_bytes": self.folder.log.size_bytes,
                **({"ended": True} if self._ended else {}),
                "config": {k: v for k, v in to_plain(self._config).items() if k not in JUDGING},
            },
        )
        self.folder.log.sync()
        save_weights(path, subject.tensors(optimizer=False), header)
        if self._drop_checkpoints(updates):  # else a phase goes on and cuts the log
            self.follower.kept(self.folder.log.size_bytes)

    def _drop_checkpoints(self, updates: Mapping[str, int]) -> bool:
        """Of phases that have nothing to go on with; whether that is all of them."""
        asked = self.learner.asked
        over = [phase for phase in updates if self._ended or updates[phase] == asked[phase]]
        for phase in over:
            self.folder.checkpoint(phase).unlink(missing_ok=True)
        return len(over) == len(updates)

    def _prove(self) -> None:
        """Before what was learnt is kept. Raises: FormatError for a damaged episode."""
        if self.proof is not None:
            self.proof.finish()

    def _fit(
        self,
        phase: str,
        subject: Subject,
        began_s: float,
        share: float,
        teacher: Teacher | None = None,
        looking: Looking | None = None,
    ) -> int:
        """One training phase with its log, checkpoints, stop and share of the time limit."""
        config, log, num_steps = self._config, self.folder.log, self.learner.asked[phase]
        checkpoint = Checkpoint(self.folder.checkpoint(phase), self.learner.hashes, log)
        first = checkpoint.resume(phase, subject)
        self.follower.kept(log.size_bytes)
        if first:
            self.progress.say(f"resuming {phase} after {first} of {num_steps} updates")
        if looking and looking.is_over():  # and was stopped before its weights were written
            return first

        def save(done: int) -> None:
            self._prove()
            checkpoint.save(phase, done, subject)
            self.follower.kept(log.size_bytes)

        def on_step(done: int, parts: dict[str, float]) -> bool:
            late = 0 < self.time_limit_s * share < time.monotonic() - began_s
            stop = self.progress.stop
            late, asked = self.group.any([late, stop.signal_number is not None])
            stop.heed(asked)
            record: dict[str, Any] = {"phase": phase, "step": done, **parts}
            regular = done % config.multitask.log_every == 0 or done == num_steps
            if regular:
                log.append(record | prompt_norms(subject.prompts))
            over = looking is not None and looking.look(done, num_steps, subject, update)
            text = f"action loss {parts['action_loss']:.4f}"
            if "distillation_loss" in parts:
                text += f"  distillation {parts['distillation_loss']:.4f}"
            try:
                self.progress.update(phase, done, num_steps, text)
            except Stopped:
                save(done)
                raise
            if late or done % config.multitask.checkpoint_every == 0:
                save(done)
            if late and not regular:
                # After the checkpoint: whoever continues there forgets the extra line.
                log.append(record | prompt_norms(subject.prompts))
            return late or over

        hardware = Hardware(config.hardware, self.group)
        parts = [subject.policy, subject.prompts, *([teacher] if teacher else [])]
        sampler = self._material.sampler(config.sampler, phase_seed(config.seed, phase))
        with hardware.working(subject.policy.backbone, subject.optimizer, *parts):
            update = Update(
                subject.policy, subject.prompts, hardware.returns(self.learner.returns),
                sampler.seed, teacher, config.multitask.sparse, hardware,
            )  # fmt: skip
            return fit(update, sampler, subject.optimizer, config.optimiser,
                       range(first, num_steps), on_step)  # fmt: skip


def prompt_norms(prompts: Prompts) -> dict[str, float]:
    """Root mean squares of the parts: P_c o P_k has one scale too many, so log them apart.

    A prompt without tokens (MT-BC, MT-ORL) has none.
    """
    return {
        f"rms_{name}": float(value.detach().square().mean().sqrt())
        for name, value in prompts.named_parameters()
        if value.numel()
    }
