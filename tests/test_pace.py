"""Intervals on a clock of the test's own."""

from mpdt.pace import Pace


def test_an_interval_begins_with_what_was_said_last() -> None:
    now = [100.0]
    pace = Pace(10, clock=lambda: now[0])
    answers = []
    for seconds, anyway in ((4, False), (6, False), (9, True), (9, False), (1, False)):
        now[0] += seconds
        answers.append(pace.is_time(anyway))
    assert answers == [False, True, True, False, True]
