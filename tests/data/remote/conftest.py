"""Real servers on the loopback interface, and a wire between that can be cut.

client ── wire (cuts after N bytes) ── asyncssh's SFTP server | aiohttp's file server
"""

from __future__ import annotations

import asyncio
import getpass
import threading
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import asyncssh
import pytest
from aiohttp import web


class Loop:
    """An event loop of its own in a thread, for servers."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()

    def run(self, work: Coroutine[Any, Any, Any]) -> Any:
        future: Future[Any] = asyncio.run_coroutine_threadsafe(work, self._loop)
        return future.result(timeout=30)

    def stop(self) -> None:
        async def cancel() -> None:
            others = asyncio.all_tasks() - {asyncio.current_task()}
            for task in others:
                task.cancel()
            await asyncio.gather(*others, return_exceptions=True)

        self.run(cancel())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(timeout=30)
        self._loop.close()


@dataclass
class Wire:
    """Forwards a port. `cuts`: after so many bytes each, the next connections are cut."""

    upstream: int
    port: int = 0
    cuts: list[int] = field(default_factory=list)
    num_bytes: int = 0
    num_connections: int = 0

    async def start(self) -> None:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]

    async def stop(self) -> None:
        self._server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.num_connections += 1
        left = [self.cuts.pop(0) if self.cuts else 1 << 40]
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self.upstream)
        both = [self._copy(reader, far_writer, left), self._copy(far_reader, writer, left)]
        tasks = [asyncio.ensure_future(copy) for copy in both]
        with suppress(asyncio.CancelledError):  # the tests are over
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            task.cancel()
        for end in (writer, far_writer):
            end.close()

    async def _copy(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, left: list[int]
    ) -> None:
        try:
            while chunk := await reader.read(1 << 14):
                self.num_bytes += len(chunk)
                left[0] -= len(chunk)
                if left[0] < 0:
                    return
                writer.write(chunk)
                await writer.drain()
        except ConnectionError:
            pass


@pytest.fixture(scope="session")
def loop() -> Iterator[Loop]:
    loop = Loop()
    yield loop
    loop.stop()


@pytest.fixture(scope="session")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A home with a key pair of the user; `host_key` is the server's."""
    home = tmp_path_factory.mktemp("home")
    (home / ".ssh").mkdir(mode=0o700)
    for name in (".ssh/id_ed25519", "host_key"):
        key = asyncssh.generate_private_key("ssh-ed25519")
        key.write_private_key(home / name)
        key.write_public_key(home / f"{name}.pub")
    return home


@pytest.fixture
def sftp(loop: Loop, keys: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Wire]:
    """An SFTP server over the whole file system, for the user's key or the password `s3cret`."""

    class Server(asyncssh.SSHServer):
        def password_auth_supported(self) -> bool:
            return True

        def validate_password(self, username: str, password: str) -> bool:
            return password == "s3cret"

    servers: list[Any] = []

    async def start() -> Wire:
        server = await asyncssh.create_server(
            Server, "127.0.0.1", 0, server_host_keys=[keys / "host_key"], sftp_factory=True,
            authorized_client_keys=str(keys / ".ssh/id_ed25519.pub"),
        )  # fmt: skip
        servers.append(server)
        wire = Wire(server.sockets[0].getsockname()[1])
        await wire.start()
        return wire

    async def stop() -> None:
        await wire.stop()
        servers[0].close()

    wire: Wire = loop.run(start())
    host_key = (keys / "host_key.pub").read_text()
    (keys / ".ssh/known_hosts").write_text(f"[127.0.0.1]:{wire.port} {host_key}")
    monkeypatch.setenv("HOME", str(keys))
    monkeypatch.delenv("SSH_AUTH_SOCK", raising=False)
    monkeypatch.setenv("USER", getpass.getuser())
    yield wire
    loop.run(stop())


@pytest.fixture
def http(loop: Loop, tmp_path: Path) -> Iterator[Wire]:
    """aiohttp's file server (ranges, ETag) over `tmp_path`/served."""
    (tmp_path / "served").mkdir()
    app = web.Application()
    app.router.add_static("/", tmp_path / "served")
    runner = web.AppRunner(app, access_log=None)

    async def start() -> Wire:
        await runner.setup()
        site = web.TCPSite(runner, "127.0.0.1", 0)
        await site.start()
        wire = Wire(runner.addresses[0][1])
        await wire.start()
        return wire

    async def stop() -> None:
        await wire.stop()
        await runner.cleanup()

    wire: Wire = loop.run(start())
    yield wire
    loop.run(stop())


@pytest.fixture
def run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """`mpdt-data` in an empty folder: exit code, stdout, stderr."""
    from mpdt.data.cli import main

    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr("os.fsync", lambda handle: None)  # no test pulls the plug

    def call(*words: object) -> tuple[int, str, str]:
        code = main([str(word) for word in words])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call
