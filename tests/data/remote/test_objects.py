"""s3:// against a real server, which rclone brings, with connections cut and refused."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from mpdt.data.remote import objects
from mpdt.data.remote.pull import pull
from mpdt.data.remote.push import push
from mpdt.errors import RemoteError

from .conftest import Loop, Wire

Run = Callable[..., tuple[int, str, str]]
MB = 1 << 20


@pytest.fixture(scope="module")
def bucket(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, int]]:
    """The folder that is the bucket `bucket`, and the server's port."""
    root = tmp_path_factory.mktemp("s3")
    (root / "bucket").mkdir()
    command = [Path(sys.executable).with_name("rclone"), "serve", "s3", str(root), "--config", ""]
    command += ["--addr", "127.0.0.1:0", "--auth-key", "KEY,SECRET"]
    # Into a file: nobody empties a pipe while the tests run, and a full one stops the server.
    said = root / "said.txt"
    with said.open("wb") as log, subprocess.Popen(command, stderr=log) as server:
        try:
            while not (found := re.search(r"127\.0\.0\.1:(\d+)", said.read_text())):
                assert server.poll() is None, said.read_text()
                time.sleep(0.05)
            yield root / "bucket", int(found[1])
        finally:
            server.kill()


@pytest.fixture
def s3(bucket: tuple[Path, int], loop: Loop, monkeypatch: pytest.MonkeyPatch) -> Iterator[Wire]:
    wire = Wire(bucket[1])
    loop.run(wire.start())
    for name, value in {
        "AWS_ACCESS_KEY_ID": "KEY", "AWS_SECRET_ACCESS_KEY": "SECRET",
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{wire.port}",
    }.items():  # fmt: skip
        monkeypatch.setenv(name, value)
    yield wire
    loop.run(wire.stop())


@pytest.fixture
def large(tmp_path: Path) -> Path:
    """An export of 12 MB."""
    folder = tmp_path / "set"
    folder.mkdir()
    numbers = np.random.PCG64(1).random_raw(12 * MB // 8)
    (folder / "large.bin").write_bytes(numbers.tobytes())
    return folder


def test_a_file_goes_there_and_back(
    s3: Wire, bucket: tuple[Path, int], run: Run, collected: Path
) -> None:
    code, out, err = run("push", collected, "s3://bucket/sets/")
    assert (code, err) == (0, "") and out.startswith("pushed  s3://bucket/sets/tiny.h5")
    there = sorted(path.name for path in (bucket[0] / "sets").iterdir())
    assert there == ["tiny.h5", "tiny.h5.sha256"]
    assert run("push", collected, "s3://bucket/sets/")[1].startswith("nothing to do")
    code, _, err = run("pull", "s3://bucket/sets/tiny.h5")
    assert (code, err) == (0, "") and Path("tiny.h5").read_bytes() == collected.read_bytes()


def test_another_file_there_stays(s3: Wire, run: Run, collected: Path, tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "one/a.txt").write_text("one")
    assert run("push", tmp_path / "one", "s3://bucket/other")[0] == 0
    (tmp_path / "one/a.txt").write_text("two")
    code, _, err = run("push", tmp_path / "one", "s3://bucket/other")
    assert code == 1 and "something else is there already" in err
    assert run("push", tmp_path / "one", "s3://bucket/other", "--replace")[0] == 0
    assert run("pull", "s3://bucket/other")[0] == 0
    assert Path("other/a.txt").read_text() == "two"


def test_cut_connections(
    s3: Wire, bucket: tuple[Path, int], large: Path, tmp_path: Path
) -> None:  # fmt: skip
    """A cut push leaves nothing that looks whole; a cut pull goes on where it stopped."""
    s3.cuts = [MB] * 20
    with pytest.raises(RemoteError):
        push(large, "s3://bucket/cut")
    assert not (bucket[0] / "cut/SHA256SUMS").exists()
    assert not (bucket[0] / "cut/large.bin").exists()
    s3.cuts = []
    push(large, "s3://bucket/cut")
    s3.cuts, s3.num_bytes = [8 * MB, 2 * MB], 0
    found = pull("s3://bucket/cut", tmp_path / "back")
    assert (tmp_path / "back/large.bin").read_bytes() == (large / "large.bin").read_bytes()
    assert found.num_new_bytes == 12 * MB and s3.num_bytes < 20 * MB


def test_a_wrong_key_is_refused(
    s3: Wire, run: Run, collected: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "wr0ng")
    code, _, err = run("push", collected, "s3://bucket/x.h5")
    assert code == 1 and "no permission" in err and "wr0ng" not in err
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    code, _, err = run("push", collected, "s3://bucket/x.h5")
    assert code == 1 and "no permission" in err


@pytest.mark.parametrize(
    ("url", "text"),
    [
        ("s3://KEY:SE/CRET@bucket/x.h5", "credentials do not belong into this URL"),
        ("s3://", "no bucket"),
        ("s3://nobucket/x.h5", "no file there"),
        ("s3://bucket/none.h5", "no file there"),
    ],
)
def test_mistakes(s3: Wire, run: Run, url: str, text: str) -> None:
    code, out, err = run("pull", url, "-o", "x.h5")
    assert code == 2 and text in err and not out and "CRET" not in err


def test_a_dead_address_is_told_in_seconds(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    began = time.monotonic()
    code, _, err = run("pull", "s3://bucket/x.h5")
    assert code == 1 and "cannot be reached" in err and time.monotonic() - began < 20


class Ends:
    """A source whose disk fails after 8 MB."""

    def open(self, mode: str) -> Ends:
        self.left = 1
        return self

    def __enter__(self) -> Ends:
        return self

    def __exit__(self, *error: object) -> None: ...

    def read(self, size: int) -> bytes:
        self.left -= 1
        if self.left < 0:
            raise OSError("the disk failed")
        return bytes(size)


def test_an_unfinished_object_is_removed(s3: Wire, bucket: tuple[Path, int]) -> None:
    """Closing the stream of a source that breaks off would make it look whole."""
    fs, path = objects.connect("s3://bucket/broken.bin", "")
    with pytest.raises(OSError, match="the disk failed"):
        objects.write(fs, path, Ends())  # type: ignore[arg-type]
    assert not (bucket[0] / "broken.bin").exists()
