"""Pace: whoever works for long says so at intervals, not at every step."""

from __future__ import annotations

import time
from collections.abc import Callable

SAY_EVERY_S = 10.0


class Pace:
    """When it is time again; the first interval begins now.

    Args:
        every_s: length of an interval in seconds.
        clock: seconds, whatever they count from.
    """

    def __init__(
        self, every_s: float = SAY_EVERY_S, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._every_s, self._clock, self._last = every_s, clock, clock()

    def is_time(self, anyway: bool = False) -> bool:
        """Whether an interval is over, or there is something to say `anyway`; begins another."""
        now = self._clock()
        if not anyway and now - self._last < self._every_s:
            return False
        self._last = now
        return True
