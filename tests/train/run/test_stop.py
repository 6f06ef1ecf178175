"""Stopping politely."""

import os
import signal

import pytest

from mpdt.train.run.stop import Stopped, StopRequest


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_is_remembered_until_asked_for(number, code):
    before = signal.getsignal(number)
    with StopRequest().listening() as stop:
        stop.check()
        os.kill(os.getpid(), number)
        with pytest.raises(Stopped) as caught:
            stop.check()
    assert caught.value.exit_code == code
    assert signal.getsignal(number) is before


def test_a_second_signal_does_not_wait():
    with StopRequest().listening(), pytest.raises(Stopped) as caught:
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGTERM)
    assert caught.value.at_once
