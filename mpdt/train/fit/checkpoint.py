"""Checkpoints that resume exactly.

A checkpoint = phase, step, trainables, AdamW's moments, length of metrics.jsonl. Batches are a
function of (seed, step), so that is all a run is: stop and resume gives the bytes of an
unbroken run (same machine, same number of threads).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from mpdt.errors import TrainingError
from mpdt.model.policy import PromptPolicy
from mpdt.model.weights import WeightsHeader, load_weights, save_weights
from mpdt.train.fit.log import MetricsLog
from mpdt.train.fit.loop import Prompts

KIND = "checkpoint"


@dataclass(frozen=True)
class Subject:
    """What one phase trains."""

    policy: PromptPolicy
    prompts: Prompts
    optimizer: torch.optim.AdamW

    def tensors(self, optimizer: bool = True) -> dict[str, Tensor]:
        """All numbers of a phase under flat names, on request without AdamW's moments."""
        own = {f"policy.{name}": value for name, value in self.policy.own_state().items()}
        own |= {f"prompts.{name}": value for name, value in self.prompts.state_dict().items()}
        state = self.optimizer.state_dict()["state"] if optimizer else {}
        for index, moments in state.items():
            own |= {f"optimizer.{index}.{name}": value for name, value in moments.items()}
        return own

    def load(self, tensors: Mapping[str, Tensor]) -> None:
        """Undo `tensors`. Raises: ShapeError if they belong to another model."""
        parts: dict[str, dict[str, Tensor]] = {"policy": {}, "prompts": {}, "optimizer": {}}
        for name, value in tensors.items():
            part, _, rest = name.partition(".")
            parts[part][rest] = value
        self.policy.load_own_state(parts["policy"])
        self.prompts.load_state_dict(parts["prompts"])
        state: dict[int, dict[str, Tensor]] = {}
        for name, value in parts["optimizer"].items():
            index, _, key = name.partition(".")
            state.setdefault(int(index), {})[key] = value
        groups = self.optimizer.state_dict()["param_groups"]
        self.optimizer.load_state_dict({"state": state, "param_groups": groups})


class Checkpoint:
    """The checkpoint file of one phase.

    Args:
        hashes: of settings and data, and of the backbone; a file of others is refused.
        log: metrics of the run, cut back to the checkpoint when resuming.
    """

    def __init__(self, path: Path, hashes: dict[str, str], log: MetricsLog) -> None:
        self.path, self.hashes, self.log = path, hashes, log

    def save(self, phase: str, step: int, subject: Subject) -> None:
        """Write atomically. Raises: StorageError if the disk refuses."""
        self.log.sync()
        header = WeightsHeader(
            kind=KIND,
            hashes=self.hashes,
            settings={"phase": phase, "step": step, "metrics_bytes": self.log.size_bytes},
        )
        save_weights(self.path, subject.tensors(), header)

    def resume(self, phase: str, subject: Subject) -> int:
        """Updates already done in `phase`; loads them into `subject` and cuts the log.

        A phase that has no checkpoint yet begins with one, so a kill at any moment repeats
        at most what came after it.
        """
        if self.path.exists():
            header, tensors = load_weights(self.path, kind=KIND, hashes=self.hashes)
            if header.settings.get("phase") == phase:
                subject.load(tensors)
                step, size = header.settings["step"], header.settings["metrics_bytes"]
                if not isinstance(step, int) or not isinstance(size, int):
                    raise TrainingError("damaged checkpoint", where=str(self.path),
                                        hint="begin anew with --restart")  # fmt: skip
                self.log.cut(size)
                return step
        self.save(phase, 0, subject)
        return 0
