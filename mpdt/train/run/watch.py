"""`mpdt-train watch RUN`: what a run is doing, read from its folder alone; it changes nothing.

    runs/ml10-base   student   since 02:10: process 4711 on host
    teacher     300/300   done
    student     350/600   0:07:20 left
    action loss 0.0124 ▇▆▄▃▂▂▁▁
    returns     come when training ends

The log has no times in it: what is left is reckoned from what is seen happen while watching.
"""

from __future__ import annotations

import json
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any, Literal, TextIO

from mpdt.data.verbs.options import or_none
from mpdt.disk.holder import Holder, writer_of
from mpdt.errors import MissingFileError, visible
from mpdt.train.evaluate.score import MEAN
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.folder import RunFolder, stored_settings
from mpdt.train.run.results import read_results, scores_in
from mpdt.train.run.show import print_results

State = Literal["training", "judging", "stopped", "done"]
EVERY_S = 1.0
_BARS = "▁▂▃▄▅▆▇█"
_MOST_BARS = 40


@dataclass(frozen=True)
class Look:
    """What the folder of a run says at one moment.

    Args:
        asked: phase -> updates it shall have, in the order of the phases.
        losses: phase -> (update, action loss) of every line of the log.
        results: results.json, once there is one.
    """

    folder: Path
    state: State
    asked: Mapping[str, int]
    losses: Mapping[str, Sequence[tuple[int, float]]]
    writer: Holder | None
    results: Mapping[str, Any] | None

    @property
    def phase(self) -> str:
        """The first one that lacks updates and none behind it has any; the last if none lacks."""
        phases = list(self.asked)
        later = {p for i, p in enumerate(phases) if any(self.losses[q] for q in phases[i + 1 :])}
        going = (p for p in phases if p not in later and self.done(p) < self.asked[p])
        return next(going, phases[-1])

    def done(self, phase: str) -> int:
        """Updates of a phase that the log tells of."""
        return self.losses[phase][-1][0] if self.losses[phase] else 0


def look(path: Path) -> Look:
    """Raises: MissingFileError for no run; FormatError for a damaged one; as `stored_settings`."""
    folder = RunFolder(path)
    config = stored_settings(path)
    asked = _asked(config)
    losses: dict[str, list[tuple[int, float]]] = {phase: [] for phase in asked}
    for record in folder.log.records():
        if record["phase"] in losses:
            losses[record["phase"]].append((record["step"], record["action_loss"]))
    writer = writer_of(path)  # before the results: it may end in between
    try:
        results = read_results(path)
    except MissingFileError:
        results = None
    state: State = "done"
    if writer is not None:
        state = "judging" if folder.weights.exists() else "training"
    elif results is None:
        state = "stopped"
    return Look(path, state, asked, losses, writer, results)


def _asked(config: TrainConfig) -> dict[str, int]:
    phases = {"teacher": config.teacher.steps, "student": config.multitask.steps}
    if config.teacher.distillation == "none":
        del phases["teacher"]
    return phases


class Rate:
    """How fast a phase goes, from the lines of its log that came while somebody watched."""

    def __init__(self) -> None:
        self._phase, self._done = "", 0
        self._came: list[tuple[int, float]] = []  # the first line and the last one, and when

    def left_s(self, phase: str, done: int, asked: int, now_s: float) -> float | None:
        """Seconds until a phase has all its updates; None before two lines were seen to come."""
        if phase != self._phase:
            self._phase, self._done, self._came = phase, done, []
        elif done != self._done:
            self._done = done
            self._came = [*self._came[:1], (done, now_s)]
        if len(self._came) < 2:
            return None
        (first, began_s), (last, ended_s) = self._came
        if last <= first:  # resumed from a checkpoint of before
            return None
        per_update_s = (ended_s - began_s) / (last - first)
        return max(0.0, per_update_s * (asked - done) - (now_s - ended_s))


def watch(path: Path, once: bool, as_json: bool, stream: TextIO | None = None) -> int:
    """Show a run until it ends; its tables then. On no terminal, or `once`, what is there now.

    Raises: as `look`.
    """
    stream = stream or sys.stdout
    seen = look(path)
    if as_json:
        stream.write(json.dumps(facts(seen), indent=1) + "\n")
        return 0
    if not once and stream.isatty() and seen.writer is not None:
        try:
            seen = _follow(seen, stream)
        except KeyboardInterrupt:
            return 130
    if seen.state == "done" and seen.results is not None:
        print_results(seen.results, False)
    else:
        stream.write(visible("\n".join(lines(seen, None)), lines=True) + "\n")
    return 0


def _follow(seen: Look, stream: TextIO) -> Look:
    """The last look, when nobody is at work there any more."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    rate = Rate()
    # Ctrl-C is how one leaves; the terminal gets its cursor back first.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with Live(console=Console(file=stream), auto_refresh=False, transient=True) as live:
            while seen.writer is not None:
                phase = seen.phase
                left_s = rate.left_s(phase, seen.done(phase), seen.asked[phase], time.monotonic())
                live.update(Text(visible("\n".join(lines(seen, left_s)), lines=True)), refresh=True)
                time.sleep(EVERY_S)
                seen = look(seen.folder)
    finally:
        signal.signal(signal.SIGINT, before)
    return seen


def lines(seen: Look, left_s: float | None) -> list[str]:
    """What is shown of a run.

    Args:
        left_s: of the phase it is in; None = not known yet.
    """
    who = f"   {seen.writer}" if seen.writer else ""
    shown = [f"{seen.folder}   {seen.state}{who}", ""]
    for phase, asked in seen.asked.items():
        done = seen.done(phase)
        told = "done" if done >= asked else ""
        if seen.state == "training" and phase == seen.phase and done < asked:
            told = "left: not known yet" if left_s is None else f"{_clock(left_s)} left"
        shown.append(f"{phase:<12} {done:>6}/{asked}   {told}".rstrip())
    for phase, points in seen.losses.items():
        if points:
            values = [loss for _, loss in points]
            shown.append(f"{'action loss':<12} {values[-1]:.4f}   {bars(values)}   {phase}")
    if seen.state == "training":
        shown.append("returns      come when it is judged, after training")
    elif seen.state == "judging":
        shown.append("returns      come when all tasks are judged")
    elif seen.state == "stopped":
        shown += ["", "nobody is at work here; the command that began it goes on where it was"]
    return shown


def facts(seen: Look) -> dict[str, Any]:
    """The same for a program."""
    scores = scores_in(seen.results) if seen.results else []
    return {
        "folder": str(seen.folder),
        "state": seen.state,
        "phases": {
            phase: {"done": seen.done(phase), "asked": asked,
                    "action_loss": seen.losses[phase][-1][1] if seen.losses[phase] else None}
            for phase, asked in seen.asked.items()
        },
        "returns": [
            {"tasks": one.block, "method": one.method, "mean": or_none(one.mean),
             "success": one.success}
            for one in scores if one.task == MEAN
        ],
    }  # fmt: skip


def bars(values: Sequence[float]) -> str:
    """The last values as a row of bars between the least and the greatest of them."""
    shown = values[-_MOST_BARS:]
    low, high = min(shown), max(shown)
    span = (high - low) or 1.0
    return "".join(_BARS[round((value - low) / span * (len(_BARS) - 1))] for value in shown)


def _clock(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
