"""push and pull against real servers, with the connection cut half-way."""

from __future__ import annotations

import errno
import gc
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from mpdt.data.remote.place import Place
from mpdt.data.remote.pull import pull
from mpdt.data.remote.push import push
from mpdt.data.remote.sums import FILE_NAME
from mpdt.data.store.reader import open_dataset
from mpdt.errors import DataError, MissingFileError, RemoteError, StorageError

Run = Callable[..., tuple[int, str, str]]
Wire = Any
MB = 1 << 20


@pytest.fixture(scope="module")
def export(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a file of 6 MB and a small one below."""
    folder = tmp_path_factory.mktemp("export") / "set"
    (folder / "data").mkdir(parents=True)
    (folder / "data/large.bin").write_bytes(np.random.PCG64(1).random_raw(6 * MB // 8).tobytes())
    (folder / "README.md").write_text("hello\n")
    return folder


def tree(folder: Path) -> dict[str, str]:
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != FILE_NAME]
    digest = {p: hashlib.sha256(p.read_bytes()).hexdigest() for p in files}
    return {str(p.relative_to(folder)): digest[p] for p in sorted(files)}


def test_a_file_goes_there_and_back(
    sftp: Wire, run: Run, collected: Path, tmp_path: Path
) -> None:  # fmt: skip
    """Found by name, checked, listed as sha256sum does; a second time nothing moves."""
    (tmp_path / "there").mkdir()
    url = f"sftp://127.0.0.1:{sftp.port}{tmp_path}/there/"
    code, out, err = run("push", collected, url)
    assert (code, err) == (0, "")
    assert out.startswith(f"pushed  {url}tiny.h5   0.")
    there = sorted(path.name for path in (tmp_path / "there").iterdir())
    assert there == ["tiny.h5", "tiny.h5.sha256"]
    check = ["sha256sum", "--check", "tiny.h5.sha256"]
    subprocess.run(check, cwd=tmp_path / "there", check=True, capture_output=True)
    assert run("push", collected, url)[1].startswith("nothing to do: there already  sftp://")

    code, out, err = run("pull", url + "tiny.h5", "--json")
    assert (code, err) == (0, "")
    found = json.loads(out)
    assert (code, found["path"], found["proof"], found["files"]) == (0, "tiny.h5", "sums", 1)
    assert found["content_hash"] == open_dataset("tiny.h5").content_hash
    assert found["moved_bytes"] == found["bytes"] == collected.stat().st_size
    assert Path("tiny.h5").read_bytes() == collected.read_bytes()
    assert [path.name for path in Path().iterdir()] == ["tiny.h5"]  # no part, no note
    assert run("pull", url + "tiny.h5")[1].startswith("nothing to do: there already  tiny.h5")


def test_broken_push_and_pull_of_a_folder_go_on(
    sftp: Wire, export: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:  # fmt: skip
    """Cut after 2 and 3 MB: what crosses the wire is little more than once the folder."""
    url = f"sftp://127.0.0.1:{sftp.port}{tmp_path}/set"
    sftp.cuts = [2 * MB, 3 * MB]
    sent = push(export, url, check=False)
    assert sent.num_new_bytes == sent.num_bytes == 6 * MB + 6
    assert tree(tmp_path / "set") == tree(export)
    assert sftp.num_connections == 3
    assert sftp.num_bytes < 8 * MB  # each cut loses what was in flight
    sftp.cuts, sftp.num_bytes, sftp.num_connections = [2 * MB, 2 * MB], 0, 0
    back = pull(url, tmp_path / "back")
    assert (back.num_files, back.num_new_bytes) == (2, 6 * MB + 6)
    assert tree(tmp_path / "back") == tree(export)
    assert sftp.num_connections == 3
    assert sftp.num_bytes < 11 * MB  # of each cut connection less than 2 MB and a chunk are lost
    assert not list(tmp_path.glob("*.part"))
    gc.collect()
    # A user would see them. The server of these tests has a thread of its own.
    ours = [record for record in caplog.records if record.threadName in ("MainThread", "fsspecIO")]
    assert not [record.getMessage() for record in ours]


def test_a_killed_pull_goes_on(http: Wire, export: Path, tmp_path: Path) -> None:
    """SIGKILL at 3 of 6 MB; the next one asks for the rest by range."""
    shutil.copytree(export, tmp_path / "served/set")
    push(export, str(tmp_path / "served/set"))  # only the list is new
    url = f"http://127.0.0.1:{http.port}/set"
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom mpdt.data.remote.pull import pull\n"
        "def tell(name, done, size):\n"
        f"    if done > {3 * MB}:\n        Path('now').touch(); time.sleep(60)\n"
        "pull(sys.argv[1], Path('set'), tell=tell)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code, url], cwd=tmp_path)
    deadline = time.monotonic() + 60
    while not (tmp_path / "now").exists():
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    part = tmp_path / "set.part/data/large.bin.part"
    kept = part.stat().st_size
    assert 3 * MB < kept < 6 * MB and not (tmp_path / "set").exists()
    http.num_bytes = 0
    found = pull(url, tmp_path / "set")
    assert found.num_new_bytes <= 6 * MB - kept + 6
    assert http.num_bytes < 6 * MB - kept + MB // 4
    assert tree(tmp_path / "set") == tree(export)


def test_a_part_of_another_state_is_not_continued(
    http: Wire, collected: Path, tmp_path: Path
) -> None:  # fmt: skip
    """A changed source starts anew; a damaged part is found; one without a note is not ours."""
    served, target = tmp_path / "served/x.h5", tmp_path / "x.h5"
    part, note = tmp_path / "x.h5.part", tmp_path / "x.h5.part.json"
    url = f"http://127.0.0.1:{http.port}/x.h5"
    content = collected.read_bytes()
    served.write_bytes(content)
    http.cuts = [0] * 9
    with pytest.raises(RemoteError, match="connection broke"):
        pull(url, target)
    assert not part.exists()  # nothing was known of the source yet
    http.cuts = []
    part.write_bytes(b"?" * 1000)
    with pytest.raises(StorageError, match="in the way"):
        pull(url, target)
    assert part.read_bytes() == b"?" * 1000 and not note.exists()
    part.unlink()
    for odd in (part, note):
        odd.symlink_to(tmp_path / "home")
        with pytest.raises(StorageError, match="in the way"):
            pull(url, target)
        odd.unlink()
    assert not (tmp_path / "home").exists()

    def half(of: bytes) -> None:
        """A pull that stops with these bytes in its part and the right note."""
        with pytest.raises(KeyboardInterrupt):
            pull(url, target, tell=interrupt)
        part.write_bytes(of[: len(content) // 2])

    def interrupt(name: str, done: int, size: int | None) -> None:
        raise KeyboardInterrupt

    half(content)
    assert pull(url, target).num_new_bytes == len(content) - len(content) // 2
    target.unlink()
    half(content)
    os.utime(served, (1, 1))  # other ETag
    assert pull(url, target).num_new_bytes == len(content)
    target.unlink()
    half(b"?" * len(content))
    with pytest.raises(DataError, match="not a whole dataset file"):
        pull(url, target)
    assert not part.exists() and not note.exists() and not target.exists()


def test_a_server_without_ranges(collected: Path, tmp_path: Path) -> None:
    """Python's own http.server sends everything again; only the missing half is written."""
    handler = partial(SimpleHTTPRequestHandler, directory=str(collected.parent))
    monkey = pytest.MonkeyPatch()
    monkey.setattr(SimpleHTTPRequestHandler, "log_message", lambda *words: None)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server, monkey.context():
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_address[1]}/tiny.h5"
        target, size = tmp_path / "x.h5", collected.stat().st_size

        def interrupt(name: str, done: int, size: int | None) -> None:
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            pull(url, target, tell=interrupt)
        (tmp_path / "x.h5.part").write_bytes(collected.read_bytes()[: size // 2])
        assert pull(url, target).num_new_bytes == size - size // 2
        server.shutdown()
    monkey.undo()
    assert target.read_bytes() == collected.read_bytes()


def test_what_an_earlier_source_left_does_not_arrive(export: Path, tmp_path: Path) -> None:
    push(export, str(tmp_path / "set"))
    back = tmp_path / "back.part"
    back.mkdir()
    (back / "notes.txt").write_text("a user's own")
    with pytest.raises(StorageError, match="in the way"):
        pull(str(tmp_path / "set"), tmp_path / "back")
    back.rename(tmp_path / "moved")

    def interrupt(name: str, done: int, size: int | None) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pull(str(tmp_path / "set"), tmp_path / "back", tell=interrupt)
    (back / "old.txt").write_text("of another state")
    (back / "README.md").write_text("hullo\n")
    pull(str(tmp_path / "set"), tmp_path / "back")
    left = {path.name for path in tmp_path.iterdir()}
    assert not left & {"back.part", "back.part.json"}
    assert tree(tmp_path / "back") == tree(export)


def test_damage_on_either_side_is_refused(
    sftp: Wire, run: Run, collected: Path, tmp_path: Path
) -> None:  # fmt: skip
    url = f"sftp://127.0.0.1:{sftp.port}{tmp_path}/tiny.h5"
    bad = shutil.copy(collected, tmp_path / "bad.h5")
    with h5py.File(bad, "r+") as file:
        file["steps/rewards"][3] += 1
    code, _, err = run("push", bad, url)
    assert code == 1 and "not a whole dataset file" in err
    assert not (tmp_path / "tiny.h5").exists()
    assert run("push", collected, url)[0] == 0
    code, _, err = run("push", bad.replace(tmp_path / "x.txt"), url)
    assert code == 1 and "not an HDF5 file" not in err
    shutil.copy(tmp_path / "x.txt", tmp_path / "tiny.h5")  # damaged there
    code, _, err = run("pull", url)
    assert code == 1 and "arrived damaged" in err and not list(Path().iterdir())
    code, _, err = run("push", collected, url)
    assert code == 1 and "something else is there already" in err and "--replace" in err
    assert run("push", collected, url, "--replace")[0] == 0
    Path("tiny.h5").write_text("mine")
    code, _, err = run("pull", url)
    assert code == 1 and "something else" in err and Path("tiny.h5").read_text() == "mine"


def test_what_arrives_damaged_is_deleted_there(
    collected: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    from mpdt.data.remote.place import Place

    def append(self: Place, path: str, source: Path, offset: int) -> None:
        Path(path).write_bytes(source.read_bytes()[:-1] + b"?")

    monkeypatch.setattr(Place, "append", append)
    with pytest.raises(DataError, match="arrived damaged, and was deleted there"):
        push(collected, f"file://{tmp_path}/x.h5")
    assert list(tmp_path.glob("x.h5*")) == []


def test_passwords_appear_nowhere(
    sftp: Wire, run: Run, collected: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch, keys: Path,
) -> None:  # fmt: skip
    """Not in results, errors, usage, tracebacks, hints after Ctrl-C, notes or lists."""

    def interrupted(*words: object, **options: object) -> None:
        signal.raise_signal(signal.SIGINT)

    name, port = os.environ["USER"], sftp.port
    good = f"sftp://{name}:s3cret@127.0.0.1:{port}{tmp_path}/x.h5"
    seen = [*run("push", collected, good, "--json"), *run("pull", good)]
    assert seen[0] == seen[3] == 0 and "sftp://***@127.0.0.1" in seen[1]
    monkeypatch.setenv("HOME", str(tmp_path))  # another home: no key, no known host
    seen += run("pull", good, "-v", "-o", "y.h5")
    assert "an unknown host" in seen[-1] and "connect once with ssh" in seen[-1]
    seen += run("plan", good)  # quoted as an unknown name
    assert "***" in seen[-1]
    for words in (("pull", "x.h5", good), ("pull", good, "--ouput", "x")):  # quoted by tyro
        with pytest.raises(SystemExit):
            run(*words)
        seen += capsys.readouterr()
    with monkeypatch.context() as patch:
        patch.setattr("mpdt.data.remote.pull.pull", interrupted)
        seen += run("pull", good)
    assert "go on with: mpdt-data pull 'sftp://***@" in seen[-1]
    seen += run("pull", "http://127.0.0.1:1/x.h5;sig=s3cret/y;sig=s3cret", "-v")
    wrong = good.replace("s3cret", "s3cret2")
    (tmp_path / ".ssh").mkdir()
    shutil.copy(keys / ".ssh/known_hosts", tmp_path / ".ssh/known_hosts")  # still no key
    seen += run("pull", wrong, "-v", "-o", "y.h5")
    assert "no permission" in seen[-1] and "docs/remote.md" in seen[-1]
    assert run("pull", good, "-o", "y.h5")[0] == 0  # by password
    for url in (wrong, wrong.replace("sftp", "sfpt"), wrong.replace("sftp", "http")):
        for verb in (("pull", url, "-v"), ("push", collected, url)):
            seen += run(*verb)
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    seen += [path.read_bytes().decode("latin1") for path in files]
    assert not [text for text in seen if "s3cret" in str(text)]


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (("pull", "sfpt://host/x.h5"), 2, "unknown protocol 'sfpt' (did you mean 'sftp'?)"),
        (("pull", "boxx"), 2, "no file there, and no folder with a list of sums"),
        (("pull", "box://x/x.h5"), 2, "boxfs"),
        (("push", "no.h5", "memory://x"), 2, "no such file or folder"),
        (("push", ".", "memory://x"), 1, "an empty folder"),
        (("push", "no.h5", "https://h/x"), 2, "http is read only"),
        (("pull", "memory://x", "-o", "no/x.h5"), 1, "folder does not exist"),
        (("pull", "sftp://127.0.0.1:1/x"), 1, "the same command goes on from here"),
        (("pull", "http://127.0.0.1:1/x.h5"), 1, "cannot be reached"),
        (("pull", "http://127.0.0.1:1/x.h5?k=v"), 1, "cannot be reached"),
        (("pull", "http://127.0.0.1:1/x.h5;k=v"), 1, "cannot be reached"),
        (("pull", "http:///x.h5"), 2, "not a URL"),
        (("pull", "http:/host/x.h5"), 2, "not a URL"),
        (("pull", "http://[::1/x.h5"), 2, "not a URL"),
        (("pull", "https://ho st/x.h5"), 2, "not a URL"),
        (("pull", "sftp://host:port/x.h5"), 2, "PROTOCOL://HOST/PATH"),
        (("pull", "webdav://ann:p#w@host/x.h5"), 2, "%23 for #"),
        (("pull", "sftp://host/a?b/x.h5"), 2, "a path of SFTP with a ?"),
    ],
)
def test_mistakes_are_one_clear_error(
    run: Run, words: tuple[str, ...], code: int, text: str
) -> None:  # fmt: skip
    found, out, err = run(*words)
    assert found == code and text in err and not out
    assert not list(Path().iterdir())


@pytest.mark.parametrize("sign", ["?sig=ab", ";sig=ab"])
def test_nothing_is_looked_for_beside_a_signed_address(
    monkeypatch: pytest.MonkeyPatch, workplace: Path, sign: str
) -> None:
    asked: list[str] = []
    monkeypatch.setattr(Place, "state", lambda self, path: None)
    monkeypatch.setattr(Place, "read", lambda self, path: asked.append(path))
    with pytest.raises(MissingFileError, match="no file there"):
        pull(f"https://host.example/x.h5{sign}")
    assert asked == []


def test_a_server_that_sends_more_than_it_announced(run: Run) -> None:
    """It is stopped there; what came is deleted."""

    class Endless(SimpleHTTPRequestHandler):
        def do_HEAD(self) -> None:
            self.send_response(200 if self.path == "/x.h5" else 404)
            self.send_header("Content-Length", "1000")
            self.end_headers()

        def do_GET(self) -> None:
            if self.path != "/x.h5":
                self.send_error(404)
                return
            self.send_response(200)  # without a length: the client reads until it is closed
            self.end_headers()
            for _ in range(4000):  # 256 MB
                self.wfile.write(bytes(1 << 16))

        def log_message(self, *words: object) -> None: ...

    with ThreadingHTTPServer(("127.0.0.1", 0), Endless) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        code, out, err = run("pull", f"http://127.0.0.1:{server.server_port}/x.h5")
        server.shutdown()
    assert code == 1 and not out and ("announced" in err or "cannot be reached" in err)
    assert sum(path.stat().st_size for path in Path().iterdir()) <= 1000


def test_a_large_list_of_sums_is_not_read(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mpdt.data.remote.place.MOST_TEXT_BYTES", 1000)
    Path("there").mkdir()
    Path("there/SHA256SUMS").write_bytes(b"0" * 2000)
    code, _, err = run("pull", "there", "-o", "here")
    assert code == 1 and "too large for a list of sums" in err


def test_a_file_goes_into_a_folder_that_is_there(run: Run, collected: Path) -> None:
    Path("backup").mkdir()
    code, out, _ = run("push", collected, "backup")
    assert code == 0 and out.startswith("pushed  backup/tiny.h5")
    assert sorted(p.name for p in Path("backup").iterdir()) == ["tiny.h5", "tiny.h5.sha256"]
    assert run("pull", "backup/tiny.h5")[0] == 0
    code, _, err = run("pull", "backup/tiny.h5", "-o", "back/")
    assert code == 1 and err.startswith("error: back: the folder does not exist")
    assert not Path("back").exists()
    Path("back").mkdir()
    for word, done in (("back/", "pulled"), ("back", "nothing to do"), ("back/.", "nothing to do")):
        code, out, err = run("pull", "backup/tiny.h5", "-o", word)
        assert code == 0 and out.startswith(done) and "back/tiny.h5" in out, err
    assert [path.name for path in Path("back").iterdir()] == ["tiny.h5"]
    with held_by_another(Path("back")):  # others may bring other files there at the same time
        assert run("pull", "backup/tiny.h5", "-o", "back")[0] == 0
    with held_by_another(Path("back/tiny.h5")):
        assert run("pull", "backup/tiny.h5", "-o", "back")[0] == 4


@contextmanager
def held_by_another(path: Path) -> Iterator[None]:
    code = (
        "import sys\nfrom pathlib import Path\nfrom mpdt.disk import holding\n"
        "with holding(Path(sys.argv[1]), amends=True): print(flush=True), input()"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-c", code, str(path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, env=environment, **pipes) as other:
        assert other.stdout is not None
        other.stdout.readline()
        yield
        other.communicate(b"\n")


def test_an_export_is_the_folder_that_is_named(run: Run, export: Path) -> None:
    assert run("push", export, "there")[0] == 0
    for word, done in (("set/", "pulled"), ("set/", "nothing to do"), ("set", "nothing to do")):
        code, out, err = run("pull", "there", "-o", word)
        assert code == 0 and out.startswith(done), err
    assert sorted(p.name for p in Path("set").iterdir()) == sorted(
        p.name for p in Path("there").iterdir()
    )


@pytest.mark.parametrize("kind", ["link", "fifo"])
def test_nothing_is_sent_that_a_link_leads_to(run: Run, export: Path, kind: str) -> None:
    shutil.copytree(export, "set")
    Path("secret.txt").write_text("my private key")
    if kind == "link":
        Path("set/data/more").symlink_to(Path("secret.txt").resolve())
    else:
        os.mkfifo("set/data/more")
    code, _, err = run("push", "set", "there")
    assert code == 1 and "a link or special file cannot be sent" in err and "set/data/more" in err
    assert not Path("there").exists()


def test_only_what_the_lock_holds(tiny_file: Path, run: Run, tmp_path: Path) -> None:
    (tmp_path / "here/datasets.yaml").write_text((tmp_path / "datasets.yaml").read_text())
    source = shutil.move(tiny_file, tmp_path / "there.h5")
    code, _, err = run("pull", source, "--locked", "-o", "tiny.h5")
    assert code == 1 and "datasets.lock has no entry tiny" in err and not Path("tiny.h5").exists()


def test_what_a_kill_behind_the_last_rename_leaves_goes(
    collected: Path, export: Path, tmp_path: Path, run: Run
) -> None:
    """A second name of the file, where the system has no renaming that replaces nothing."""
    there, back, tree_back = tmp_path / "there", tmp_path / "x.h5", tmp_path / "set"
    there.mkdir()
    assert run("push", collected, f"{there}/")[0] == run("push", export, there / "set")[0] == 0
    for source, target in ((there / collected.name, back), (there / "set", tree_back)):
        assert run("pull", source, "-o", target)[0] == 0
        (tmp_path / f"{target.name}.part.json").write_text("[]")
    (tmp_path / "x.h5.part").hardlink_to(back)

    def interrupt(name: str, done: int, size: int | None) -> None:
        raise KeyboardInterrupt

    other = tmp_path / "y.h5"
    with pytest.raises(KeyboardInterrupt):
        pull(str(there / collected.name), other, tell=interrupt)
    (tmp_path / "y.h5.part").unlink()
    (tmp_path / "y.h5.part").hardlink_to(back)
    for source, target in ((there / collected.name, back), (there / "set", tree_back)):
        assert run("pull", source, "-o", target)[1].startswith("nothing to do")
    assert run("pull", there / collected.name, "-o", other)[0] == 0
    assert back.read_bytes() == other.read_bytes() == collected.read_bytes()
    assert not back.samefile(other)  # what is written into one would be in the other
    assert not list(tmp_path.glob("*.part*"))


@pytest.mark.parametrize(
    ("number", "text"), [(errno.ENOSPC, "there is full"), (errno.EROFS, "there is read-only")]
)
def test_a_disk_that_refuses_is_no_broken_connection(
    collected: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch,
    number: int, text: str,
) -> None:  # fmt: skip
    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("mpdt.data.remote.place.put_file", refuse)
    code, _, err = run("push", collected, tmp_path / "there/x.h5")
    assert code == 1 and f"the disk {text}" in err and "connection" not in err
