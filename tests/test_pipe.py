"""`| head` ends a command quietly; a pipe of our own that breaks does not."""

from __future__ import annotations

import io
import os
import subprocess
import sys

import pytest

from mpdt.pipe import reader_may_leave

RUN = "import sys; sys.argv[0] = 'prog'; from {} import main; sys.exit(main())"
# More than a pipe holds, so that the write itself fails and not only the flush at the end.
MUCH = "from mpdt.pipe import reader_may_leave\nwith reader_may_leave():\n    print('x' * 10**6)\n"


def closed_early(code: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run python with a stdout that nobody reads."""
    reading, writing = os.pipe()
    os.close(reading)
    try:
        return subprocess.run(
            [sys.executable, "-c", code, *words],
            stdout=writing, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    finally:
        os.close(writing)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (RUN.format("mpdt.data.cli"), ["--help"]),
        (RUN.format("mpdt.data.cli"), ["list"]),
        (RUN.format("mpdt.train.cli"), ["--help"]),
        (MUCH, []),
    ],
)
def test_a_reader_that_leaves_ends_the_command_quietly(code: str, words: list[str]) -> None:
    done = closed_early(code, *words)
    assert (done.returncode, done.stderr) == (0, "")


def test_another_pipe_that_breaks_is_an_error() -> None:
    """A worker that died: its pipe says so, and whoever reads stdout is still there."""
    with pytest.raises(BrokenPipeError), reader_may_leave():
        raise BrokenPipeError


def test_leaving_the_program_and_streams_that_are_no_files(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    with pytest.raises(SystemExit) as stop, reader_may_leave():
        raise SystemExit(2)
    assert stop.value.code == 2
    with pytest.raises(BrokenPipeError), reader_may_leave():
        raise BrokenPipeError
