"""A command as a user types it, in a fork of this process: no import is paid for twice."""

from __future__ import annotations

import os
import signal
import sys
import time
import traceback
from collections.abc import Sequence
from pathlib import Path


def start(
    words: Sequence[str], said: Path, folder: Path, delay_s: float = 0.0, limit_s: float = 0.0
) -> int:
    """The number of the process, which says everything into one file.

    Args:
        words: those behind `mpdt-data`, or TRAIN and those behind `mpdt-train`.
        said: file for stdout and stderr.
        folder: where it is typed.
        limit_s: SIGALRM ends it then; 0 = never.
    """
    pid = os.fork()
    if pid:
        return pid
    code = 70
    try:
        signal.alarm(int(limit_s))
        handle = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(handle, 1)
        os.dup2(handle, 2)
        os.chdir(folder)
        time.sleep(delay_s)
        code = _answer(words)
    except BaseException:  # noqa: BLE001  it is shown, and counted
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _answer(words: Sequence[str]) -> int:
    if words[0] != "TRAIN":
        from mpdt.data.cli import main

        sys.argv = ["mpdt-data", *words]
        return main(list(words))
    from mpdt.train.cli import main as train

    sys.argv = ["mpdt-train", *words[1:]]
    try:
        train(words[1:])
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0
