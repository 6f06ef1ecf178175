"""SFTP through sshfs, for hosts that are known, and asked whether they still answer.

sshfs alone accepts whoever answers, and then sends a password; and it waits for ever for a host
that fell silent. To import this is to make it what fsspec takes for `sftp` and `ssh`.
"""

from __future__ import annotations

import logging
from contextlib import suppress
from pathlib import Path
from typing import Any

import asyncssh
import fsspec
from sshfs import SSHFileSystem

from mpdt.errors import MpdtError, RemoteError

ALIVE_S = 15  # a silent host is asked so often, and given up after three questions


class SecureShell(SSHFileSystem):  # type: ignore[misc]
    """Files of one host.

    Args:
        host: as in the URL; `known_hosts` and everything else of asyncssh.connect can stand in
            fsspec's configuration of `sftp`.
    Raises: RemoteError for a host that ~/.ssh/known_hosts does not know by this key; what asyncssh
        raises.
    """

    protocol = ("sftp", "ssh")

    def __init__(self, host: str, **options: Any) -> None:
        path = Path("~/.ssh/known_hosts").expanduser()
        strangers: list[MpdtError] = []
        known = {"known_hosts": str(path) if path.exists() else b""}
        alive = {"keepalive_interval": ALIVE_S, "connect_timeout": 2 * ALIVE_S}
        try:
            super().__init__(host, **(known | alive | options),
                             client_factory=lambda: _Asked(path, strangers))  # fmt: skip
        except Exception:
            if strangers:
                raise strangers[0] from None
            raise

    def close(self) -> None:
        """Leave at once: the connection may be broken, or its other end silent."""
        with suppress(RuntimeError):  # the loop is over
            self.loop.call_soon_threadsafe(self.client.abort)


class _Asked(asyncssh.SSHClient):  # type: ignore[misc]
    """Is asked about a key that the list does not have, and keeps the answer for the caller."""

    def __init__(self, path: Path, strangers: list[MpdtError]) -> None:
        self._path, self._strangers = path, strangers

    def validate_host_public_key(self, host: str, addr: str, port: int, key: Any) -> bool:
        known: Any = ((),)
        if self._path.exists():
            known = asyncssh.match_known_hosts(str(self._path), host, addr, port)
        what = "another host key than the known one" if known[0] else "an unknown host"
        found = f"{key.get_algorithm()} {key.get_fingerprint()}"
        self._strangers.append(RemoteError(what, where=host, found=found,
                               hint="connect once with ssh, which shows the key and asks; "
                                    f"it is kept in {self._path}"))  # fmt: skip
        return False


def _is_news(record: logging.LogRecord) -> bool:
    """Whether a line of asyncio says more than that a connection broke, which we say ourselves.

    asyncssh reads and writes with many tasks and tells the exception of the first; asyncio prints
    the others, with tracebacks, and each packet that was still to be sent.
    """
    error = record.exc_info[1] if record.exc_info else None
    is_late = record.threadName == "fsspecIO" and record.msg == "socket.send() raised exception."
    return not (is_late or isinstance(error, asyncssh.Error))


logging.getLogger("asyncio").addFilter(_is_news)
for _protocol in SecureShell.protocol:
    fsspec.register_implementation(_protocol, SecureShell, clobber=True)
