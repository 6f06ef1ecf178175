"""A signal ends the command, wherever in it it comes."""

from __future__ import annotations

import ctypes
import signal
import sys
import time
from contextlib import suppress

import pytest

from mpdt.interruption import Interrupted, interruptible

BOTH = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])


class Signalling:
    """Gets its signal while it is destroyed, as an array or file that is let go."""

    def __init__(self, number: signal.Signals) -> None:
        self.number = number

    def __del__(self) -> None:
        signal.raise_signal(self.number)


def state() -> list[object]:
    handlers = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)]
    return [*handlers, sys.unraisablehook, signal.getitimer(signal.ITIMER_REAL)]


@BOTH
def test_in_a_plain_step(number):
    before = state()
    with pytest.raises(Interrupted) as caught, interruptible():
        signal.raise_signal(number)
    assert caught.value.exit_code == 128 + number
    assert state() == before


@BOTH
def test_in_a_destructor_it_comes_a_moment_later(number):
    before, began = state(), time.monotonic()
    with pytest.raises(Interrupted), interruptible():
        one = Signalling(number)
        del one
        while time.monotonic() < began + 20:
            pass
    assert time.monotonic() < began + 10
    assert state() == before


@BOTH
def test_in_a_callback_from_c(number):
    began = time.monotonic()
    callback = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(number))
    with pytest.raises(Interrupted), interruptible():
        callback()
        while time.monotonic() < began + 20:
            pass
    assert time.monotonic() < began + 10


def test_what_a_library_makes_of_it_is_still_the_signal():
    with pytest.raises(Interrupted), interruptible():
        try:
            signal.raise_signal(signal.SIGTERM)
        except BaseException as error:
            raise RuntimeError("something went wrong in the reader") from error


def test_swallowed_it_comes_at_the_end():
    with pytest.raises(Interrupted), interruptible(), suppress(BaseException):
        signal.raise_signal(signal.SIGTERM)


def test_other_errors_and_other_unraisable_ones_pass(monkeypatch):
    seen = []
    monkeypatch.setattr(sys, "unraisablehook", lambda args: seen.append(args.exc_type))

    class Broken:
        def __del__(self):
            raise OSError

    with pytest.raises(KeyError), interruptible():
        one = Broken()
        del one
        raise KeyError
    assert seen == [OSError]
