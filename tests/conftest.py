"""For all tests: Ctrl-C works, and the long ones are begun first: none is left at the end."""

from __future__ import annotations

import signal

import pytest


def pytest_configure() -> None:
    # Run in the background of a script, the tests inherit an ignored Ctrl-C.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.get_closest_marker("long") is None)
