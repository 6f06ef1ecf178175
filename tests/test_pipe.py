"""`| head` ends a command quietly; a pipe of our own that breaks does not."""

from __future__ import annotations

import io
import os
import shlex
import subprocess
import sys

import pytest

from mpdt.pipe import reader_may_leave

RUN = "import sys; sys.argv[0] = 'prog'; from {} import main; sys.exit(main())"
# More than a pipe holds, so that the write itself fails and not only the flush at the end.
MUCH = "from mpdt.pipe import reader_may_leave\nwith reader_may_leave():\n    print('x' * 10**6)\n"

TABLE = (
    "from mpdt.pipe import reader_may_leave, table_console\n"
    "with reader_may_leave():\n    console = table_console()\n"
    "    for _ in range(2000):\n        console.print('x' * 70)\n"
)


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
        (TABLE, []),
        (MUCH, []),
    ],
)
def test_a_reader_that_leaves_ends_the_command_quietly(code: str, words: list[str]) -> None:
    done = closed_early(code, *words)
    assert (done.returncode, done.stderr) == (0, "")


FULL, CLOSED = (">/dev/full", "No space left on device"), (">&-", "Bad file descriptor")
SILENT = ((">/dev/full 2>&-", ""), (">&- 2>/dev/full <&-", ""))


# Every command on a full disk, both programs closed and silent.
@pytest.mark.parametrize(("program", "words", "where", "found"), [
    *(("data", words, *FULL) for words in (["--help"], ["list"], ["list", "--json"])),
    ("train", ["methods"], *FULL),
    *((program, ["--help"], *how) for program in ("data", "train") for how in (CLOSED, *SILENT)),
    ("data", ["list"], *CLOSED),
])  # fmt: skip
def test_a_stdout_that_cannot_be_written_is_one_error(
    program: str, words: list[str], where: str, found: str
) -> None:
    done = in_shell(RUN.format(f"mpdt.{program}.cli"), words, where)
    said = f"error: stdout: cannot be written; found {found}\n" if found else ""
    assert (done.returncode, done.stdout, done.stderr) == (1, "", said)


@pytest.mark.parametrize("where", ["2>&-", "2>/dev/full", "<&-"])
def test_results_come_without_talk_and_codes_stay(where: str) -> None:
    done = in_shell(RUN.format("mpdt.data.cli"), ["completion", "bash"], where)
    assert (done.returncode, done.stderr) == (0, "") and len(done.stdout) > 1000
    done = in_shell(RUN.format("mpdt.data.cli"), ["show", "not-there.h5"], where)
    assert (done.returncode, done.stdout) == (2, "")


def test_what_a_closed_stdout_leaves_free_is_no_file_of_ours() -> None:
    """Number 1 would be the next file that is opened, and what is printed would go into it."""
    code = (
        "import os, sys\nfrom mpdt.pipe import reader_may_leave\nwith reader_may_leave():\n"
        "    handle = os.open('/dev/null', os.O_RDONLY)\n    sys.stderr.write(str(handle > 2))"
    )
    assert in_shell(code, [], ">&- <&-").stderr == "True"


def test_a_terminal_that_lacks_characters() -> None:
    code = (
        "import sys\nfrom mpdt.pipe import reader_may_leave\nwith reader_may_leave():\n"
        "    print('\\u2581\\xe9')"
    )
    env = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, check=False)
    assert (done.stdout, done.stderr) == (b"\\u2581\\xe9\n", b"")


def in_shell(code: str, words: list[str], where: str) -> subprocess.CompletedProcess[str]:
    line = shlex.join([sys.executable, "-c", code, *words])
    return subprocess.run(
        f"{line} {where}", shell=True, capture_output=True, text=True, check=False
    )


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
