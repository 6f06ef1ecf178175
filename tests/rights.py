"""A command as somebody whom file modes bind: tests may run as root, whom they do not."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager

_GET_SECUREBITS, _SET_SECUREBITS = 27, 28  # of prctl
_NO_FIXUP = 4  # access() of root goes by the effective rights then, not by all it might have
_VERSION_3 = 0x20080522
_SETS = 6  # effective, permitted, inheritable: low words, then high


@contextmanager
def without_rights() -> Iterator[None]:
    """The rights of root are laid down within the block, by this thread."""
    if os.getuid() != 0:
        yield
        return
    system = ctypes.CDLL(None)
    header, had = (ctypes.c_uint32 * 2)(_VERSION_3, 0), (ctypes.c_uint32 * _SETS)()
    bits = system.prctl(_GET_SECUREBITS, 0, 0, 0, 0)
    less = (ctypes.c_uint32 * _SETS)()
    _done(system.capget(header, had))
    less[:] = [0 if i % 3 == 0 else word for i, word in enumerate(had)]
    _done(system.prctl(_SET_SECUREBITS, bits | _NO_FIXUP, 0, 0, 0))
    _done(system.capset(header, less))
    try:
        yield
    finally:
        _done(system.capset(header, had))
        _done(system.prctl(_SET_SECUREBITS, bits, 0, 0, 0))


def _done(answer: int) -> None:
    if answer:
        raise OSError("root keeps its rights")
