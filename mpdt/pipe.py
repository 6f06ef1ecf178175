"""Whoever reads our output may have enough: `mpdt-data list | head` is no error."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO


@contextmanager
def reader_may_leave() -> Iterator[None]:
    """Run a command line; end it quietly where the reader of stdout or stderr is gone.

    What is left in a buffer is written here, not at interpreter exit, where Python would print a
    traceback. A BrokenPipeError of another pipe (a worker that died) passes through.
    """
    try:
        try:
            yield
        except SystemExit:  # help, which tyro prints before it leaves
            sys.stdout.flush()
            raise
        sys.stdout.flush()
    except BrokenPipeError:
        gone = [stream for stream in (sys.stdout, sys.stderr) if _has_no_reader(stream)]
        if not gone:
            raise
        for stream in gone:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _has_no_reader(stream: TextIO) -> bool:
    try:
        handle = stream.fileno()
    except (OSError, ValueError):  # replaced by something that is no file
        return False
    poll = select.poll()
    poll.register(handle, select.POLLERR)
    return any(event & select.POLLERR for _, event in poll.poll(0))
