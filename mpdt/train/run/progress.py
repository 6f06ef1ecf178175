"""How far a run is, on stderr: a bar on a terminal, else one line per phase and ten seconds.

Whoever reports is told to stop here as well, so the two travel together.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TextIO

from mpdt.errors import visible
from mpdt.pace import SAY_EVERY_S, Pace
from mpdt.train.run.stop import StopRequest

BAR_EVERY_S = 0.2


class Progress:
    """Args:
    quiet: say nothing.
    stop: asked after every update; None = nobody stops it.

    `also`, where it is set, is asked together with it and raises what ends the run.
    """

    def __init__(
        self, quiet: bool = False, stop: StopRequest | None = None, stream: TextIO | None = None
    ) -> None:
        self.stop = stop or StopRequest()
        self.also: Callable[[], None] | None = None
        self._quiet, self._stream = quiet, stream or sys.stderr
        self._terminal = self._stream.isatty()
        self._pace = Pace(BAR_EVERY_S if self._terminal else SAY_EVERY_S)
        self._phase, self._began_s, self._first = "", 0.0, 0
        self._open = False

    def say(self, text: str) -> None:
        """One line of its own."""
        if not self._quiet:
            self._close()
            self._stream.write(visible(text, lines=True) + "\n")
            self._stream.flush()

    def update(self, phase: str, done: int, total: int, text: str = "") -> None:
        """`done` of `total` steps of a phase; a new phase starts its own clock.

        Raises: Stopped after a signal; what `also` raises.
        """
        self._show(phase, done, total, text)
        if self.also is not None:
            self.also()
        self.stop.check()

    def _show(self, phase: str, done: int, total: int, text: str) -> None:
        now = time.monotonic()
        first, last = phase != self._phase, done >= total
        if first:
            self._close()
            self._phase, self._began_s, self._first = phase, now, done
        if self._quiet or not self._pace.is_time(anyway=first or last):
            return
        per_step_s = (now - self._began_s) / max(1, done - self._first)
        left_s = per_step_s * (total - done)
        clock = f"{int(left_s) // 60}:{int(left_s) % 60:02d} left" if not last else "done"
        self.write(f"{phase:<12} {done:>6}/{total}  {clock:<12} {text}", last)

    def write(self, line: str, last: bool) -> None:
        """Show where a phase is; `last`: it ends here."""
        line = visible(line)
        if self._terminal:
            self._stream.write("\r" + line[:118].ljust(118) + ("\n" if last else ""))
            self._open = not last
        else:
            self._stream.write(line.rstrip() + "\n")
        self._stream.flush()

    def _close(self) -> None:
        if self._open:
            self._stream.write("\n")
            self._open = False
