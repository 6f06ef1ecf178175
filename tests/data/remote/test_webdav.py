"""push and pull through WebDAV, against wsgidav on loopback: a protocol that cannot append."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import fsspec.config
import numpy as np
import pytest
from cheroot import wsgi
from wsgidav.wsgidav_app import WsgiDAVApp

from mpdt.data.remote.pull import pull
from mpdt.data.remote.push import push
from mpdt.errors import RemoteError

from .conftest import Loop, Wire

MB = 1 << 20


@pytest.fixture
def wire(loop: Loop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Wire]:
    """`tmp_path`/served for ann with the password pw, whom fsspec's configuration names."""
    (tmp_path / "served").mkdir()
    users = {"*": {"ann": {"password": "pw"}}}
    app = WsgiDAVApp({
        "provider_mapping": {"/": str(tmp_path / "served")}, "verbose": 0,
        "simple_dc": {"user_mapping": users}, "logging": {"enable": False},
    })  # fmt: skip
    server = wsgi.Server(("127.0.0.1", 0), app)
    server.prepare()
    thread = threading.Thread(target=server.serve, daemon=True)
    thread.start()
    wire = Wire(server.bind_addr[1])
    loop.run(wire.start())
    monkeypatch.setitem(fsspec.config.conf, "webdav", {"auth": ("ann", "pw")})
    monkeypatch.setattr("os.fsync", lambda handle: None)  # no test pulls the plug
    yield wire
    loop.run(wire.stop())
    server.stop()
    thread.join(timeout=30)


def test_a_folder_goes_there_and_back(
    wire: Wire, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    folder, served = tmp_path / "set", tmp_path / "served/set"
    (folder / "data").mkdir(parents=True)
    (folder / "a.txt").write_text("x")
    content = np.random.PCG64(1).random_raw(4 * MB // 8).tobytes()
    (folder / "data/large.bin").write_bytes(content)
    url = f"webdav://127.0.0.1:{wire.port}/set"
    wire.cuts = [2 * MB] * 9
    with pytest.raises(RemoteError, match="connection broke"):
        push(folder, url)
    assert not (served / "data/large.bin").exists() and not (served / "SHA256SUMS").exists()
    wire.cuts = []
    assert push(folder, url).num_new_bytes == 4 * MB  # a.txt was there
    assert (served / "data/large.bin").read_bytes() == content
    assert not list(served.rglob("*.part"))
    assert push(folder, url).num_new_bytes == 0
    (folder / "a.txt").write_text("y")
    push(folder, url, replace=True)
    assert (served / "a.txt").read_text() == "y"
    assert pull(url, tmp_path / "back").num_new_bytes == 4 * MB + 1
    assert (tmp_path / "back/data/large.bin").read_bytes() == content
    monkeypatch.setitem(fsspec.config.conf, "webdav", {"auth": ("ann", "wr0ng")})
    with pytest.raises(RemoteError, match="no permission") as caught:
        pull(url, tmp_path / "again")
    assert "wr0ng" not in caught.value.render() and "docs/remote.md" in caught.value.hint
