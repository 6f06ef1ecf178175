"""SFTP through sshfs, for hosts that are known, and asked whether they still answer.

sshfs alone accepts whoever answers, and then sends a password; and it waits for ever for a host
that fell silent.
"""

from __future__ import annotations

import logging
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import asyncssh
from sshfs import SSHFileSystem
from sshfs.file import SSHFile

from mpdt.errors import MpdtError, RemoteError

ALIVE_S = 15  # a silent host is asked so often, and given up after three questions
SSH_PORT = 22
_UNUSABLE = (asyncssh.KeyImportError, asyncssh.KeyEncryptionError, asyncssh.ConfigParseError)


def connect(url: str) -> tuple[SecureShell, str]:
    """The files of a host, and the path of `url` there; `/~/` begins where a login does.

    fsspec would take `[::1]` for two URLs, and leave `%40` in a password.
    Raises: as SecureShell.
    """
    parts = urlsplit(url)
    told = {"username": unquote(parts.username or ""), "password": unquote(parts.password or ""),
            "port": parts.port}  # fmt: skip
    host = parts.netloc.rpartition("@")[2]  # `hostname` is in small letters, names of ssh are not
    host = host[1:].partition("]")[0] if host.startswith("[") else host.partition(":")[0]
    path = parts.path.rstrip("/") or "/"
    if path == "/~" or path.startswith("/~/"):
        path = path[3:].lstrip("/") or "."
    known = {key: value for key, value in told.items() if value}
    return SecureShell(host, skip_instance_cache=True, **known), path


class SecureShell(SSHFileSystem):  # type: ignore[misc]
    """Files of one host.

    Args:
        host: as in the URL; `known_hosts` and everything else of asyncssh.connect can stand in
            fsspec's configuration of `sftp`.
    Raises: RemoteError for a host that ~/.ssh/known_hosts does not know by this key; what asyncssh
        raises.
    """

    protocol = ("sftp", "ssh")  # where its options stand in fsspec's configuration

    def __init__(self, host: str, **options: Any) -> None:
        path = Path("~/.ssh/known_hosts").expanduser()
        strangers: list[MpdtError] = []
        known = {"known_hosts": str(path) if path.exists() else b""}
        alive = {"keepalive_interval": ALIVE_S, "connect_timeout": 2 * ALIVE_S}
        try:
            super().__init__(host, **(known | alive | options),
                             client_factory=lambda: _Asked(path, strangers))  # fmt: skip
        except Exception as error:
            if strangers:
                raise strangers[0] from None
            if own := _of_this_machine(error):
                raise own from None
            raise

    def _open(self, path: str, mode: str = "rb", **options: Any) -> SSHFile:
        return _File(self, path, mode, **options)

    def close(self) -> None:
        """Leave at once: the connection may be broken, or its other end silent."""
        with suppress(RuntimeError):  # the loop is over
            self.loop.call_soon_threadsafe(self.client.abort)


class _File(SSHFile):  # type: ignore[misc]
    """Is left at once where something went wrong.

    To close it asks the server, which may be silent or gone; and what Ctrl-C raised would be
    lost in that answer. The handle there ends with the connection.
    """

    _closed: bool

    def __exit__(self, *error: Any) -> None:
        self._closed = self._closed or error[0] is not None
        super().__exit__(*error)


def _of_this_machine(error: Exception) -> MpdtError | None:
    """A key, or a file that ~/.ssh/config names, and no connection was tried with it."""
    name = getattr(error, "filename", None)
    if isinstance(error, OSError) and name:
        return RemoteError("a file of ssh cannot be read", where=str(name),
                           found=error.strerror or "",
                           hint="~/.ssh/config may name it")  # fmt: skip
    if isinstance(error, _UNUSABLE):
        return RemoteError("keys or settings of ssh cannot be used", where="~/.ssh",
                           found=f"{type(error).__name__}: {error}",
                           hint="a passphrase comes from ssh-agent or FSSPEC_SFTP_PASSPHRASE; "
                                "`ssh` to the same host shows more")  # fmt: skip
    return None


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
        at = f" (port {port})" if port != SSH_PORT else ""
        self._strangers.append(RemoteError(what, where=host, found=found,
                               hint=f"connect once with ssh{at}, which shows the key and asks; "
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
