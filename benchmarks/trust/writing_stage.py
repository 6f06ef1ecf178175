"""Where writers.py lets commands meet: sources, a target, a user's own files of similar names.

A command is run in a fork of a process that has all modules loaded. What it leaves when nobody
disturbs it is measured first.
"""

from __future__ import annotations

import os
import re
import shutil
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import forks
import numpy as np
from writing_commands import COMMANDS, ENTRY, TRAINING

UNFINISHED = re.compile(r"t\.h5(\.tta-n\d+)?\.parts?(\.json)?$")


@dataclass
class Job:
    """A command on its way: a forked process, what it said, how it ended."""

    kind: str
    name: str
    pid: int
    said: Path
    signal: int = 0
    code: int = field(default=-1)

    @property
    def text(self) -> str:
        return self.said.read_text(errors="replace")

    def wait(self) -> None:
        self.code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])


@dataclass
class Stage:
    """A working folder with its sources, and what commands leave when nobody disturbs them."""

    sources: Path
    place: Path
    random: np.random.Generator
    calm: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    number: int = 0

    @property
    def target(self) -> Path:
        return self.place / "t.h5"

    def clear(self) -> None:
        """An empty folder, but for a user's own files of similar names."""
        shutil.rmtree(self.place, ignore_errors=True)
        self.place.mkdir()
        (self.place / "t.h5.tmp").mkdir()
        (self.place / "t.h5.tmp" / "notes").write_text("mine")
        (self.place / "mine").write_text("mine")
        (self.place / ".t.h5.tmp").symlink_to("mine")

    def own_files_stay(self) -> bool:
        link, notes = self.place / ".t.h5.tmp", self.place / "t.h5.tmp" / "notes"
        return (
            link.is_symlink() and link.read_text() == "mine" == notes.read_text()
            and (self.place / "mine").read_text() == "mine"
        )  # fmt: skip

    def left_behind(self, goes_on: bool) -> list[str]:
        """Names beside the target that are nobody's result.

        Args:
            goes_on: a command did not get through, so what it has so far may stay.
        """
        known = {"t.h5", "t.h5.tmp", "mine", ".t.h5.tmp", "t.h5.sha256"}
        names = {path.name for path in self.place.iterdir()} - known
        return sorted(name for name in names if not (goes_on and UNFINISHED.match(name)))

    def start(self, kind: str, delay_s: float = 0.0, name: str = "") -> Job:
        """Run a command in a fork of this process."""
        self.number += 1
        name, said = name or f"n{self.number}", self.sources.parent / f"said-{self.number}"
        words = [
            word.replace("T", str(self.target), 1) if word in ("T", "T/..") else
            name if word == "N" else word.replace("S/", f"{self.sources}/")
            for word in COMMANDS[kind].words.replace("QUICK", TRAINING).split()
        ]  # fmt: skip
        pid = forks.start(words, said, self.place.parent, delay_s)
        return Job(kind, name, pid, said)

    def measure(self, kind: str) -> None:
        """Run a command by itself, once: what it leaves, and how long it takes."""
        if kind in self.calm:
            return
        self.clear()
        if COMMANDS[kind].start == "dataset":
            shutil.copy(self.sources / "cd.h5", self.target)
        began = time.monotonic()
        job = self.start(kind)
        job.wait()
        self.seconds[kind] = time.monotonic() - began
        if job.code:
            raise SystemExit(f"FAIL: {kind} by itself\n{job.text}")
        self.calm[kind] = COMMANDS[kind].result(self.target, job.name)

    def holds(self, job: Job) -> bool:
        """Whether the target is, or contains, what this command leaves."""
        try:
            return bool(COMMANDS[job.kind].result(self.target, job.name) == self.calm[job.kind])
        except Exception:  # noqa: BLE001  whatever is there, it is not that
            return False


def prepare(folder: Path, random: np.random.Generator, training: bool) -> Stage:
    """A stage with its sources."""
    stage = Stage(folder / "sources", folder / "place", random)
    stage.sources.mkdir()
    (stage.sources / "datasets.yaml").write_text(ENTRY)
    stage.place.mkdir()
    here = f"{stage.sources}/"
    texts = [
        f"collect tiny --workers 0 -o {here}cd.h5 --spec {here}datasets.yaml",
        f"split {here}cd.h5 --quality medium -o {here}m.h5",
        f"split {here}cd.h5 --quality expert -o {here}e.h5",
        f"export {here}cd.h5 --to npz -o {here}npz",
        f"push {here}npz {here}sent",
        f"TRAIN --data {here}cd.h5 --runs-dir {stage.sources} --name run {TRAINING}",
    ]
    for text in texts[: None if training else -1]:
        if os.waitpid(forks.start(text.split(), folder / "said", folder), 0)[1]:
            raise SystemExit(f"FAIL: {text}\n{(folder / 'said').read_text()}")
    (stage.sources / "datasets.lock").unlink(missing_ok=True)
    return stage
