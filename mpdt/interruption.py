"""Interruption: SIGINT and SIGTERM end a command, wherever in it they come.

Python raises what a handler raises at the next step of the program, whatever that is: in a
destructor or a callback from C it is printed and forgotten, in a library that turns every
exception into its own it has another name. Both are noticed here.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

_AGAIN_S = 0.01


class Interrupted(BaseException):
    """A signal. Not an Exception, so that only a command line catches it."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.exit_code = 128 + number


@contextmanager
def interruptible() -> Iterator[None]:
    """Raises: Interrupted in the block, once for every signal that comes."""
    came: list[int] = []

    def arrive(number: int, _frame: FrameType | None) -> NoReturn:
        if number != signal.SIGALRM:
            came.append(number)
        raise Interrupted(came[-1])

    def notice(unraisable: sys.UnraisableHookArgs) -> None:
        if not isinstance(unraisable.exc_value, Interrupted):
            hook(unraisable)
            return
        # Raised from here it would be lost once more.
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
    hook, sys.unraisablehook = sys.unraisablehook, notice
    handlers = [signal.signal(number, arrive) for number in numbers]
    try:
        yield
    except Interrupted:
        raise
    except BaseException as error:
        if came:
            raise Interrupted(came[-1]) from error
        raise
    else:
        if came:
            raise Interrupted(came[-1])
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in zip(numbers, handlers, strict=True):
            signal.signal(number, handler)
        sys.unraisablehook = hook
