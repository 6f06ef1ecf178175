"""An address where no Ray cluster answers is told in seconds; asked without Ray."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from mpdt.data.workers import ray


@contextmanager
def server(answer: bytes) -> Iterator[str]:
    """Somebody who takes one call and says `answer`, at the address that is yielded."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        called: list[socket.socket] = []

        def serve() -> None:
            there, _ = listening.accept()
            called.append(there)
            if answer:
                there.sendall(answer)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"127.0.0.1:{listening.getsockname()[1]}"
        thread.join()
        called[0].close()


def test_a_server_of_its_protocol_is_believed() -> None:
    for prefix in ("", "ray://"):
        with server(bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])) as address:
            ray._ask(prefix + address)


def test_a_web_server_is_no_cluster() -> None:
    with (
        server(b"HTTP/1.1 400 Bad Request\r\n\r\n") as address,
        pytest.raises(OSError, match="no Ray"),
    ):
        ray._ask(address)


def test_whoever_says_nothing_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray, "ANSWER_S", 0.1)
    with server(b"") as address, pytest.raises(TimeoutError):
        ray._ask(address)
