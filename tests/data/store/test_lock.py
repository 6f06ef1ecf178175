"""One holder at a time, named in the refusal; a lock on a deleted file is no lock."""

import fcntl
import os
import subprocess
import sys

import pytest

from mpdt.data.store.lock import take_lock
from mpdt.errors import BusyError

CODE = """
import sys
from pathlib import Path
from mpdt.data.store.lock import take_lock
try:
    take_lock(Path(sys.argv[1]), "taken", Path("here"), "nothing is lost")
except Exception as error:
    print(type(error).__name__, error.exit_code, error.message(), "|", error.hint)
"""


def test_another_process_is_told_who_holds_it(tmp_path):
    lock = take_lock(tmp_path / "new" / "x.pid", "taken", tmp_path, "")
    command = [sys.executable, "-c", CODE, str(tmp_path / "new" / "x.pid")]
    other = subprocess.run(command, capture_output=True, text=True, check=True)
    me = os.getpid()
    assert other.stdout.startswith(f"BusyError 4 here: taken (process {me}) | ")
    assert f"`kill {me}`; nothing is lost" in other.stdout
    assert (tmp_path / "new" / "x.pid").read_text() == str(me), "the refused one changed nothing"
    lock.close()
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == ""


def test_twice_in_one_process(tmp_path):
    with take_lock(tmp_path / "x.pid", "taken", tmp_path, ""), pytest.raises(BusyError):
        take_lock(tmp_path / "x.pid", "taken", tmp_path, "")


def test_a_lock_on_a_deleted_file_is_no_lock(tmp_path, monkeypatch):
    """The first try locks a file that its finishing holder deletes meanwhile."""
    path, locks = tmp_path / "gone" / "x.pid", []

    def flock(file, mode):
        locks.append(file)
        if len(locks) == 1:
            path.unlink()
            path.parent.rmdir()

    monkeypatch.setattr(fcntl, "flock", flock)
    with take_lock(path, "taken", tmp_path, ""):
        assert len(locks) == 2 and path.read_text() == str(os.getpid())
