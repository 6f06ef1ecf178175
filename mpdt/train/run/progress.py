"""How far a run is, on stderr: a bar on a terminal, else one line per phase and ten seconds.

Whoever reports is told to stop here as well, so the two travel together.
"""

from __future__ import annotations

import sys
import time
from typing import TextIO

from mpdt.errors import visible
from mpdt.train.run.stop import StopRequest

LINE_EVERY_S = 10.0


class Progress:
    """Args:
    quiet: say nothing.
    stop: asked after every update; None = nobody stops it.
    """

    def __init__(
        self, quiet: bool = False, stop: StopRequest | None = None, stream: TextIO | None = None
    ) -> None:
        self.stop = stop or StopRequest()
        self._quiet, self._stream = quiet, stream or sys.stderr
        self._terminal = self._stream.isatty()
        self._phase, self._began_s, self._first, self._said_s = "", 0.0, 0, 0.0
        self._open = False

    def say(self, text: str) -> None:
        """One line of its own."""
        if not self._quiet:
            self._close()
            self._stream.write(visible(text, lines=True) + "\n")
            self._stream.flush()

    def update(self, phase: str, done: int, total: int, text: str = "") -> None:
        """`done` of `total` steps of a phase; a new phase starts its own clock.

        Raises: Stopped after a signal.
        """
        self._show(phase, done, total, text)
        self.stop.check()

    def _show(self, phase: str, done: int, total: int, text: str) -> None:
        now = time.monotonic()
        if phase != self._phase:
            self._close()
            self._phase, self._began_s, self._first, self._said_s = phase, now, done, 0.0
        last = done >= total
        wait_s = 0.2 if self._terminal else LINE_EVERY_S
        if self._quiet or (now - self._said_s < wait_s and not last):
            return
        self._said_s = now
        per_step_s = (now - self._began_s) / max(1, done - self._first)
        left_s = per_step_s * (total - done)
        clock = f"{int(left_s) // 60}:{int(left_s) % 60:02d} left" if not last else "done"
        line = visible(f"{phase:<12} {done:>6}/{total}  {clock:<12} {text}")
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
