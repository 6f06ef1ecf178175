"""One writer at a time, named in the refusal; what a killed one leaves is no obstacle."""

import errno
import fcntl
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from mpdt.disk import Seen, hold, holding, replacing
from mpdt.disk.holder import Holder
from mpdt.errors import BusyError, StorageError

HOLD = """
import sys, time
from pathlib import Path
from mpdt.disk import holding, replacing
with holding(Path(sys.argv[1])), replacing(Path(sys.argv[2])) as temporary:
    temporary.write_text("half")
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def holder():
    """Starts a process that holds a target and has half of a file in it; kills it at the end."""
    processes = []

    def start(target, file=None):
        command = [sys.executable, "-c", HOLD, str(target), str(file or target)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        processes.append(process)
        assert process.stdout.readline() == "held\n"
        return process

    yield start
    for process in processes:
        process.kill()
        process.communicate()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_another_process_is_told_who_holds_it(tmp_path, holder):
    target = tmp_path / "x"
    other = holder(target)
    before = names(tmp_path)
    with pytest.raises(BusyError) as caught, holding(target, wait_s=0, kept="parts are kept"):
        pass
    error = caught.value
    assert (error.exit_code, error.what) == (4, "another process writes it")
    assert error.found.startswith(f"process {other.pid} on ")
    assert "since 20" in error.found
    assert error.hint == f"wait for it, or end it with `kill {other.pid}`; parts are kept"
    assert names(tmp_path) == before, "the refused one changed nothing"


def test_a_killed_holder_is_no_obstacle_and_its_half_goes(tmp_path, holder):
    target = tmp_path / "x"
    target.write_text("old")
    other = holder(target)
    other.kill()
    other.wait()
    assert len(names(tmp_path)) == 3, "lock and temporary file are left"
    (tmp_path / ".x.0123456789abcdef.tmp").write_text("a user's own")
    with replacing(target) as temporary:
        temporary.write_text("new")
    assert target.read_text() == "new"
    assert names(tmp_path) == [".x.0123456789abcdef.tmp", "x"]


def test_what_a_killed_holder_of_a_folder_had_in_it_goes_too(tmp_path, holder):
    folder = tmp_path / "run"
    (folder / "sub").mkdir(parents=True)
    other = holder(folder, folder / "sub" / "x")
    assert len(names(folder / "sub")) == 1, "the folder's lock is enough for what is in it"
    other.kill()
    other.wait()
    with holding(folder, amends=True):
        assert names(folder / "sub") == []
    assert names(tmp_path) == ["run"]


def test_what_is_named_after_the_target_is_covered_too(tmp_path, holder):
    (tmp_path / "x.h5.parts").mkdir()
    for name in ("x.h5.part.json", "x.h5.parts/plan"):
        other = holder(tmp_path / "x.h5", tmp_path / name)
        assert not (tmp_path / f".{name}.lock").exists()
        assert (tmp_path / ".x.h5.lock").exists()
        with holding(tmp_path / "x.h5.tmp", wait_s=0), holding(tmp_path / "x.h", wait_s=0):
            pass  # other names are others'
        other.kill()
        other.wait()
        with holding(tmp_path / "x.h5"):
            assert names(tmp_path) == [".x.h5.lock", "x.h5.parts"]
            assert names(tmp_path / "x.h5.parts") == []


def test_waits_for_another(tmp_path, holder):
    target = tmp_path / "x"
    other = holder(target)
    threading.Timer(0.2, other.kill).start()
    began = time.monotonic()
    with holding(target, wait_s=20):
        assert 0.1 < time.monotonic() - began < 15


def test_threads_of_one_process_exclude_each_other_and_one_thread_not_itself(tmp_path):
    target, found = tmp_path / "x", []

    def other():
        try:
            with holding(target, wait_s=0):
                found.append("held")
        except BusyError:
            found.append("busy")

    with holding(target) as outer, holding(target) as inner:
        assert outer is inner
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
    assert found == ["busy"]
    assert names(tmp_path) == []


def test_a_forked_child_holds_nothing(tmp_path):
    target = tmp_path / "x"
    with holding(target):
        child = os.fork()
        if child == 0:
            code = 1
            try:
                with holding(target, wait_s=0):
                    pass
            except BusyError:
                code = 4
            finally:
                os._exit(code)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 4
        assert (tmp_path / ".x.lock").exists()


def test_what_came_while_waiting_is_not_replaced_unless_it_is_amended(tmp_path, holder):
    target = tmp_path / "x"

    def write_and_kill(other):
        target.write_text("the other's")
        other.kill()

    for amends in (False, True):
        target.unlink(missing_ok=True)
        other = holder(target)
        threading.Timer(0.2, write_and_kill, [other]).start()
        if amends:
            with holding(target, amends=True) as held:
                assert held.found == Seen.at(target)
        else:
            with pytest.raises(BusyError, match="meanwhile") as caught, holding(target):
                pass
            assert caught.value.found.startswith(f"process {other.pid} on")
        assert target.read_text() == "the other's"


def test_a_lock_file_that_was_swapped_is_no_lock(tmp_path, monkeypatch):
    """The first try locks a file that its finishing holder deletes meanwhile."""
    lock, calls, flock = tmp_path / ".x.lock", [], fcntl.flock

    def late(handle, mode):
        calls.append(handle)
        if len(calls) == 1:
            lock.unlink()
        flock(handle, mode)

    monkeypatch.setattr(fcntl, "flock", late)
    with holding(tmp_path / "x"):
        assert len(calls) == 2
        assert json.loads(lock.read_text())["pid"] == os.getpid()


@pytest.mark.parametrize("kind", ["link", "dangling", "file", "fifo", "folder"])
def test_what_is_not_ours_is_not_taken_for_a_lock(tmp_path, kind):
    lock, mine = tmp_path / ".x.lock", tmp_path / "mine"
    if kind == "link":
        mine.write_text("precious")
        lock.symlink_to(mine)
    elif kind == "dangling":
        lock.symlink_to(mine)
    elif kind == "file":
        lock.write_text("precious")
    elif kind == "fifo":
        os.mkfifo(lock)
    else:
        lock.mkdir()
    before = names(tmp_path)
    with pytest.raises(StorageError) as caught, holding(tmp_path / "x"):
        pass
    assert caught.value.hint
    assert names(tmp_path) == before
    assert (
        kind not in ("link", "file") or "precious" in (mine if kind == "link" else lock).read_text()
    )


def test_a_holder_is_read_as_it_was_written(monkeypatch):
    me = Holder.me()
    assert Holder.of(me.encoded()) == me
    said = json.loads(me.encoded())
    for change in (
        {"format": "other"}, {"pid": "1"}, {"pid": 0}, {"token": "../../x"}, {"more": 1},
        {"host": "\x1b[2J"}, {"command": 3},
    ):  # fmt: skip
        assert Holder.of(json.dumps(said | change).encode()) is None
    for content in (b"", b"{", b"[]", b"\xff", b"[" * 3000):
        assert Holder.of(content) is None
    assert me.may_live
    assert not Holder.of(json.dumps(said | {"start": "1"}).encode()).may_live, "the id came again"
    assert Holder.of(json.dumps(said | {"host": "far", "start": "1"}).encode()).may_live
    assert Holder.of(json.dumps(said | {"start": ""}).encode()).may_live, "it could not be told"
    monkeypatch.setattr(Path, "read_text", lambda self, **_: "")
    assert me.may_live and Holder.of(json.dumps(said | {"start": "1"}).encode()).may_live


def test_only_program_and_verb_are_told(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["/bin/mpdt-data", "pull", "http://ann:secret@host/x.h5"])
    assert Holder.me().command == "mpdt-data pull"
    monkeypatch.setattr(sys, "argv", ["/bin/mpdt-train", "--data", "secret"])
    assert Holder.me().command == "mpdt-train"


# --- file systems without locks ---------------------------------------------------------------


@pytest.fixture(params=[errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
def no_locks(request, monkeypatch):
    def flock(handle, mode):
        raise OSError(request.param, os.strerror(request.param))

    monkeypatch.setattr(fcntl, "flock", flock)
    monkeypatch.setattr(hold, "_told", set())


def left_by(lock: Path, **changes: object) -> None:
    said = json.loads(Holder.me().encoded()) | {"token": "0123456789abcdef", **changes}
    lock.write_text(json.dumps(said))


def test_without_locks_the_file_is_the_lock_and_it_is_said_once(tmp_path, no_locks, caplog):
    for _ in range(2):
        with replacing(tmp_path / "x") as temporary:
            temporary.write_text("new")
            assert (tmp_path / ".x.lock").exists()
    assert names(tmp_path) == ["x"]
    assert [record.message.count("no locks") for record in caplog.records] == [1]


def test_without_locks_a_living_holder_is_respected(tmp_path, no_locks):
    left_by(tmp_path / ".x.lock")
    with (
        pytest.raises(BusyError, match=f"process {os.getpid()} on"),
        holding(tmp_path / "x", wait_s=0),
    ):
        pass
    left_by(tmp_path / ".x.lock", host="elsewhere", pid=1)
    with pytest.raises(BusyError) as caught, holding(tmp_path / "x", wait_s=0):
        pass
    assert f"if it is gone, delete {tmp_path / '.x.lock'}" in caught.value.hint
    assert "kill" not in caught.value.hint


def test_without_locks_a_dead_holder_is_no_obstacle(tmp_path, no_locks):
    gone = subprocess.Popen(["true"])
    gone.wait()
    left_by(tmp_path / ".x.lock", pid=gone.pid)
    (tmp_path / ".x.0123456789abcdef.tmp").write_text("half")
    with replacing(tmp_path / "x") as temporary:
        temporary.write_text("new")
    assert names(tmp_path) == ["x"]


def test_without_locks_a_new_lock_is_not_removed_for_an_old_one(tmp_path, no_locks, monkeypatch):
    """Between the look at a dead holder's lock and its removal somebody else was quicker."""
    lock, gone = tmp_path / ".x.lock", subprocess.Popen(["true"])
    gone.wait()
    left_by(lock, pid=gone.pid)
    remove = hold._remove

    def late(*args, **kwargs):
        lock.unlink()
        left_by(lock)
        remove(*args, **kwargs)

    monkeypatch.setattr(hold, "_remove", late)
    with pytest.raises(BusyError), holding(tmp_path / "x", wait_s=0):
        pass
    assert names(tmp_path) == [".x.lock"]


def test_an_interrupt_gives_the_lock_back(tmp_path):
    with pytest.raises(KeyboardInterrupt), holding(tmp_path / "x"):
        signal.raise_signal(signal.SIGINT)
    assert names(tmp_path) == []


def test_a_full_disk_leaves_no_lock(tmp_path, monkeypatch):
    def full(handle, content):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(StorageError, match="full"), holding(tmp_path / "x"):
        pass
    monkeypatch.undo()
    assert names(tmp_path) == []


@pytest.mark.parametrize("name", ["write", "unlink"])
def test_a_signal_at_the_edge_of_a_hold_leaves_no_lock(tmp_path, monkeypatch, name):
    calls = []

    def signalled(*args, **options):
        calls.append(args)
        if len(calls) == 1:
            raise KeyboardInterrupt
        return step(*args, **options)

    place = os if name == "write" else Path
    step = getattr(place, name)
    monkeypatch.setattr(place, name, signalled)
    with pytest.raises(KeyboardInterrupt), holding(tmp_path / "x"):
        pass
    monkeypatch.undo()
    assert list(tmp_path.iterdir()) == []
