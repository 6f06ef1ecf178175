"""One process at a time: an advisory lock on a file that shows who holds it."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import IO

from mpdt.errors import BusyError


def take_lock(path: Path, busy: str, where: Path, kept: str) -> IO[str]:
    """Create `path` with its folders, lock it and write the own process id into it.

    Close the file to give the lock back; the kernel does so for a killed process. The holder
    may delete the file and its folder before that.

    Args:
        busy: what to say if another holds it, such as "another collector holds this target".
        where: what the error is about.
        kept: what ending the other process does not lose.
    Raises: BusyError with the other process's id; OSError where the disk refuses.
    """
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = path.open("a+", encoding="ascii")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.seek(0)
            owner = lock.read().strip() or "unknown"
            lock.close()
            raise BusyError(
                f"{busy} (process {owner})",
                where=str(where),
                hint=f"wait for it, or end it with `kill {owner}`; {kept}",
            ) from None
        # The folder may have been deleted by a holder that just finished.
        if path.exists() and os.fstat(lock.fileno()).st_ino == path.stat().st_ino:
            lock.truncate(0)
            lock.write(str(os.getpid()))
            lock.flush()
            return lock
        lock.close()
