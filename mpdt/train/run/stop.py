"""The polite way to stop: a signal is remembered, what was done is saved, then the run ends."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Stopped(Exception):  # noqa: N818 - not an error: the user asked for it
    """The run was asked to stop and has saved what it had. Exit code 128 + signal.

    Args:
        at_once: asked again, and perhaps in the middle of that.
    """

    def __init__(self, signal_number: int, at_once: bool = False) -> None:
        super().__init__(f"stopped by {signal.Signals(signal_number).name}")
        self.at_once = at_once
        self.exit_code = 128 + signal_number


class StopRequest:
    """Remembers SIGINT or SIGTERM until the loop asks. A second one ends at once."""

    def __init__(self) -> None:
        self.signal_number: int | None = None

    def check(self) -> None:
        """Raises: Stopped if a signal has come."""
        if self.signal_number is not None:
            raise Stopped(self.signal_number)

    def heed(self, asked: bool) -> None:
        """Where another process of a group was asked to stop, so was this one."""
        if asked and self.signal_number is None:
            self.signal_number = signal.SIGTERM

    @contextmanager
    def listening(self, patient: bool = False) -> Iterator[StopRequest]:
        """Signals are remembered inside the block; the old handlers return afterwards.

        Args:
            patient: a second one ends nothing at once; it may be the same request once more.
        """

        def remember(number: int, _frame: FrameType | None) -> None:
            if self.signal_number is not None and not patient:
                raise Stopped(number, at_once=True)
            self.signal_number = number

        numbers = (signal.SIGINT, signal.SIGTERM)
        old = [signal.signal(number, remember) for number in numbers]
        try:
            yield self
        finally:
            for number, handler in zip(numbers, old, strict=True):
                signal.signal(number, handler)
