"""Lines on a stream that is no terminal."""

import io

from mpdt.train.run.progress import Progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_first_and_last_line_of_a_phase():
    stream = io.StringIO()
    progress = Progress(stream=stream)
    for done in range(1, 101):
        progress.update("student", done, 100, f"loss {done}")
    lines = stream.getvalue().splitlines()
    assert len(lines) == 2, "one when it begins, one when it ends, none in between within 10 s"
    assert lines[0].split()[:2] == ["student", "1/100"]
    assert lines[1].split() == ["student", "100/100", "done", "loss", "100"]


def test_a_terminal_line_is_rewritten_and_closed_before_talk():
    stream = Terminal()
    progress = Progress(stream=stream)
    progress.update("student", 1, 100)
    progress.say("hello")
    assert stream.getvalue().startswith("\rstudent") and stream.getvalue().endswith("\nhello\n")


def test_quiet_says_nothing():
    stream = io.StringIO()
    progress = Progress(quiet=True, stream=stream)
    progress.say("hello")
    progress.update("student", 1, 1)
    assert stream.getvalue() == ""
