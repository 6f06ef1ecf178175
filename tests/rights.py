"""A command as somebody whom file modes bind: tests may run as root, whom they do not."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from pathlib import Path

_SECUREBITS, _NO_ROOT = 28, 1  # of prctl: a new program of root gets no rights for that
_VERSION_3 = 0x20080522
_HEADER, _NO_RIGHTS = (ctypes.c_uint32 * 2)(_VERSION_3, 0), (ctypes.c_uint32 * 6)()


def _give_up() -> None:
    system = ctypes.CDLL(None)
    if os.getuid() == 0 and (
        system.prctl(_SECUREBITS, _NO_ROOT, 0, 0, 0) or system.capset(_HEADER, _NO_RIGHTS)
    ):
        raise OSError("root keeps its rights")


def without_rights(module: str, *words: object, cwd: Path) -> tuple[int, str]:
    """Exit code and stderr of `python -m MODULE WORDS` there."""
    path = os.pathsep.join(one for one in sys.path if one)
    done = subprocess.run(
        [sys.executable, "-m", module, *map(str, words)], cwd=cwd, text=True, check=False,
        env=os.environ | {"PYTHONPATH": path}, preexec_fn=_give_up, capture_output=True,
    )  # fmt: skip
    return done.returncode, done.stderr
