"""Progress of a collection on stderr: a bar on a terminal, else one line per 10 s."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from mpdt.errors import visible
from mpdt.pace import Pace

if TYPE_CHECKING:
    from mpdt.data.collect.collect import Progress


class Speed:
    """Steps per second and time left, from what this run has done itself."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._start = clock()

    def steps_per_s(self, progress: Progress) -> float:
        own = progress.done_steps - progress.resumed_steps
        return own / max(1e-9, self._clock() - self._start)

    def text(self, progress: Progress, label: bool = True) -> str:
        """`52/74 blocks  520,000 steps  41.2k steps/s  eta 0:00:05  forward-expert-3`."""
        rate = self.steps_per_s(progress)
        left = progress.num_steps - progress.done_steps
        eta = f"{_clock_text(left / rate)}" if rate > 0 else "-:--:--"
        return (
            f"{progress.done_blocks}/{progress.num_blocks} blocks  "
            f"{progress.done_steps:,} steps  {_rate_text(rate)} steps/s  eta {eta}"
            + (f"  {progress.last.label}" if progress.last and label else "")
        )


def _rate_text(rate: float) -> str:
    return f"{rate / 1000:.1f}k" if rate >= 1000 else f"{rate:.0f}"


def _clock_text(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


@contextmanager
def show_progress(quiet: bool = False) -> Iterator[Callable[[Progress], None]]:
    """What `collect` calls after each block, as a bar, as lines, or as nothing."""
    if quiet:
        yield lambda progress: None
    elif sys.stderr.isatty():
        with _bar() as tell:
            yield tell
    else:
        yield line_writer(lambda line: print_line(line))


def print_line(line: str) -> None:
    sys.stderr.write(visible(line) + "\n")
    sys.stderr.flush()


def line_writer(
    write: Callable[[str], None], clock: Callable[[], float] = time.monotonic
) -> Callable[[Progress], None]:
    """One line at the start of a resumed run, every 10 s, and at the end."""
    speed, pace = Speed(clock), Pace(clock=clock)

    def tell(progress: Progress) -> None:
        if progress.last is None:
            if note := resume_note(progress):
                write(note)
        elif pace.is_time(anyway=progress.done_blocks == progress.num_blocks):
            write(f"collect  {speed.text(progress)}")

    return tell


def resume_note(progress: Progress) -> str:
    """`resuming: 31 of 74 blocks done, 0 damaged`, or nothing for a fresh start."""
    if not (progress.resumed_blocks or progress.damaged_blocks or progress.outdated_blocks):
        return ""
    note = (
        f"resuming: {progress.resumed_blocks} of {progress.num_blocks} blocks done, "
        f"{progress.damaged_blocks} damaged"
    )
    if progress.outdated_blocks:
        note += f", {progress.outdated_blocks} made again: other rates or weights"
    return note


@contextmanager
def _bar() -> Iterator[Callable[[Progress], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn
    from rich.progress import Progress as RichProgress

    console = Console(stderr=True)  # a narrow one has no room for the block's label
    speed = Speed()
    text = TextColumn("{task.description}", markup=False)
    columns = (TextColumn("collect"), BarColumn(bar_width=12), text)
    with RichProgress(*columns, console=console, transient=False) as bar:
        task = bar.add_task("", total=None)

        def tell(progress: Progress) -> None:
            if progress.last is None and (note := resume_note(progress)):
                bar.console.print(visible(note), highlight=False, markup=False)
            bar.update(
                task,
                total=progress.num_steps,
                completed=progress.done_steps,
                description=visible(speed.text(progress, label=console.width >= 110)),
            )

        yield tell
