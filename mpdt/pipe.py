"""Standard output: whoever reads it may have enough, and a disk that is full is one error.

`mpdt-data list | head` is no error; `mpdt-data list > /dev/full` and `>&-` are.
"""

from __future__ import annotations

import io
import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.console import Console

_WIDTH = 160
"""Columns without a terminal; tables in a log file are not folded at 80."""


@contextmanager
def reader_may_leave() -> Iterator[None]:
    """Run a command line; end it quietly where the reader of stdout or stderr is gone.

    What is left in a buffer is written here, not at interpreter exit, where Python would print a
    traceback. A BrokenPipeError of another pipe (a worker that died) passes through.

    Raises: SystemExit with 1, and one line on stderr, where stdout cannot be written.
    """
    _fill_standard_files()
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
            _throw_away(stream)
    except _RefusedError as error:
        _throw_away(sys.stdout)
        sys.stderr.write(f"error: stdout: cannot be written; found {error.strerror}\n")
        raise SystemExit(1) from None


class _RefusedError(OSError):
    """stdout cannot be written."""


class _Results(io.TextIOWrapper):
    """stdout whose refusals are told from those of other files."""

    def write(self, text: str) -> int:
        with _told_apart():
            return super().write(text)

    def flush(self) -> None:
        with _told_apart():
            super().flush()


@contextmanager
def _told_apart() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise _RefusedError(error.errno, error.strerror) from error


class _Talk(io.TextIOWrapper):
    """stderr on which talk is lost where it cannot be written, and nothing else."""

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except BrokenPipeError:
            raise
        except OSError:
            return len(text)

    def flush(self) -> None:
        try:
            super().flush()
        except BrokenPipeError:
            raise
        except OSError:
            pass


def table_console() -> Console:
    """rich's on stdout; it leaves to us a reader that has enough, which rich answers by ending the
    process with 1.
    """
    from rich.console import Console

    class _Ours(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    return _Ours(file=sys.stdout, width=None if sys.stdout.isatty() else _WIDTH)


def _fill_standard_files() -> None:
    """Give 0, 1 and 2 a file where the caller closed them.

    Else the next file that is opened would be number 1, and what is printed would go into it. That
    of stdout cannot be written, which is then told; talk on stderr is nobody's.
    """
    for number, flags in ((0, os.O_RDONLY), (1, os.O_RDONLY), (2, os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, flags)  # takes the lowest number that is free
    if sys.stdout is None or sys.stdout is sys.__stdout__:
        sys.stdout = _opened_again(_Results, 1, sys.stdout)
    if sys.stderr is None or sys.stderr is sys.__stderr__:
        sys.stderr = _opened_again(_Talk, 2, sys.stderr)


def _opened_again(
    kind: type[io.TextIOWrapper], number: int, old: TextIO | None
) -> io.TextIOWrapper:
    """A standard file as it was, but of that kind, and with a code for what its encoding lacks."""
    if old is not None:
        old.flush()
    buffer = io.BufferedWriter(io.FileIO(number, "w", closefd=False))
    return kind(buffer, getattr(old, "encoding", "utf-8"), "backslashreplace",
                line_buffering=number == 2 or os.isatty(number))  # fmt: skip


def _throw_away(stream: TextIO) -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _has_no_reader(stream: TextIO) -> bool:
    try:
        handle = stream.fileno()
    except (OSError, ValueError):  # replaced by something that is no file
        return False
    poll = select.poll()
    poll.register(handle, select.POLLERR)
    return any(event & select.POLLERR for _, event in poll.poll(0))
