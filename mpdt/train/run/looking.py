"""Looking: the action error on validation episodes while the student trains, and what it may end.

    every checkpoint, and the last update    a line of phase `validation` in metrics.jsonl
    patience > 0                             the weights of the best look are kept beside; training
                                             ends when so many looks brought nothing better

All that decides is in metrics.jsonl, which a resumed run cuts back to its checkpoint: it looks
again and finds the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mpdt.errors import TrainingError
from mpdt.model.prompts import AdaptedPrompts, TeacherPrompts
from mpdt.model.weights import WeightsHeader, load_weights, save_weights
from mpdt.train.fit.checkpoint import Subject
from mpdt.train.fit.loop import Update
from mpdt.train.fit.validation import PHASE, Validation, best_look
from mpdt.train.run.folder import RunFolder

KIND = "best look"


@dataclass(frozen=True)
class Looking:
    """Args:
    hashes: what every file of the run's weights is bound to.
    every: updates between two looks.
    """

    validation: Validation
    folder: RunFolder
    hashes: Mapping[str, str]
    every: int
    patience: int

    def look(self, done: int, last: int, subject: Subject, update: Update) -> bool:
        """After `done` of `last` updates, if it is time; whether patience is at its end."""
        if done % self.every and done != last:
            return False
        assert not isinstance(update.prompts, TeacherPrompts | AdaptedPrompts)
        error = self.validation.action_error(
            update.policy, update.prompts, update.returns, update.hardware
        )
        self.folder.log.append({"phase": PHASE, "step": done, "action_error": error})
        if self.patience and best_look(self.folder.log.records())[0] == done:
            header = WeightsHeader(kind=KIND, hashes=dict(self.hashes), settings={"step": done})
            save_weights(self._best, subject.tensors(optimizer=False), header)
        return self.is_over()

    def is_over(self) -> bool:
        """Whether patience is at its end."""
        records = self.folder.log.records()
        looked = any(record["phase"] == PHASE for record in records)
        return self.patience > 0 and looked and best_look(records)[1] >= self.patience

    def take_best(self, subject: Subject) -> int:
        """Put the weights of the best look into `subject`; the updates they have.

        Raises: as `load_weights`; TrainingError where they are of another look.
        """
        step, _ = best_look(self.folder.log.records())
        header, tensors = load_weights(self._best, kind=KIND, hashes=self.hashes)
        if header.settings["step"] != step:
            raise TrainingError("weights of another look than the best one", where=str(self._best),
                                expected=f"update {step}", found=str(header.settings["step"]),
                                hint="begin anew with --restart")  # fmt: skip
        subject.load(tensors)
        return step

    def forget(self) -> None:
        self._best.unlink(missing_ok=True)

    @property
    def _best(self) -> Path:
        return self.folder.checkpoint("best")
