"""Hold: one writer of a file or folder at a time, and everybody else is told who that is.

    x.h5                  what is written
    .x.h5.lock            there while somebody writes it, flocked, and says who
    .x.h5.<token>.tmp     what that process has of the new x.h5

The kernel ends the flock of a killed process. The lock file that it leaves is then no obstacle:
the next writer of x.h5 removes it, and the temporary files with its token. A hold covers what is in
the target and what is named after it: run/..., x.h5.parts/..., x.h5.part.json.

Where the file system has no flock, which is said once, the lock file alone is the lock: it is
made in one step or not at all, and counts as left behind if its process is gone from this machine.
"""

from __future__ import annotations

import errno
import fcntl
import glob
import logging
import os
import shutil
import stat
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from mpdt.disk.holder import Holder, read_holder
from mpdt.disk.refusal import disk, expect_folder
from mpdt.errors import BusyError, MpdtError, StorageError, quoted

WAIT_S = 10.0
"""How long a writer waits for another one by default."""
_POLL_S, _INTRODUCTION_S = 0.02, 0.5
# EBADF: NFS will not lock what another user's lock file was opened for, reading.
_NO_LOCKS = {
    errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EINVAL, errno.EBADF,
}  # fmt: skip
_log = logging.getLogger(__name__)
_told: set[int] = set()
_mine = threading.local()


@dataclass(frozen=True)
class Seen:
    """What is at a path: the same numbers are the same file with the same content."""

    device: int
    inode: int
    size: int
    changed_ns: int

    @classmethod
    def of(cls, found: os.stat_result) -> Seen:
        plain = not stat.S_ISDIR(found.st_mode)  # a folder stays itself whatever comes into it
        return cls(found.st_dev, found.st_ino, plain * found.st_size, plain * found.st_mtime_ns)

    @classmethod
    def at(cls, path: Path) -> Seen | None:
        """None where nothing is. Raises: OSError."""
        try:
            return cls.of(os.lstat(path))
        except FileNotFoundError:
            return None


@dataclass
class Hold:
    """A target that this process alone writes.

    Args:
        path: the target itself, behind all links.
        found: what was there at the start, and since then whatever this process put there.
    """

    path: Path
    token: str
    found: Seen | None
    pid: int

    @property
    def temporary(self) -> Path:
        """A name beside the target that nobody else has."""
        return self.path.with_name(f".{self.path.name}.{self.token}.tmp")


@contextmanager
def holding(
    target: Path, *, amends: bool = False, wait_s: float = WAIT_S, kept: str = ""
) -> Iterator[Hold]:
    """Keep every other process of ours from writing `target`. In one thread it may be nested.

    Args:
        amends: what another process writes while this one waits is to be read, not replaced:
            `found` is what is there once the target is held. Otherwise that is an error.
        kept: what ending the process that holds it does not lose.
    Raises: BusyError naming the process that holds it, or if another process wrote `target`
        while this one waited; StorageError where the disk refuses.
    """
    with disk(target):
        path = real_path(target)
        if not path.parent.is_dir():
            parent = path.parent if target.is_symlink() else target.parent
            expect_folder(parent)
        holds: dict[Path, Hold] = _mine.__dict__.setdefault("holds", {})
        cover = holds.get(path) or next((holds[p] for p in holds if _covers(p, path)), None)
        if cover is not None and cover.pid != os.getpid():  # a forked child holds nothing
            holds.clear()
            cover = None
        found = Seen.at(path)
        if cover is None:
            lock = path.with_name(f".{path.name}.lock")
            me = Holder.me()
            handle, waited_for = _take(lock, path, me, time.monotonic() + wait_s, kept)
    if cover is not None and cover.path == path:
        yield cover
        return
    hold = Hold(path, cover.token if cover else me.token, found, os.getpid())
    holds[path] = hold
    try:
        with disk(target):
            now = Seen.at(path)
        if amends:
            hold.found = now
        elif now != found:
            raise written_meanwhile(target, waited_for if cover is None else None)
        yield hold
    finally:
        holds.pop(path, None)
        if cover is None and hold.pid == os.getpid():
            try:
                _unlink_own(lock, handle)
            except BaseException:  # a signal, in the middle of it
                _unlink_own(lock, handle)
                raise
            finally:
                os.close(handle)


def sweep(target: Path) -> None:
    """What a killed process left beside `target` goes, unless somebody is at work; no error.

    A hold does that; for whoever has nothing to write.
    """
    with suppress(MpdtError), holding(target, amends=True, wait_s=0):
        pass


def written_meanwhile(target: Path, by: Holder | None = None) -> BusyError:
    return BusyError("another process wrote it meanwhile", where=str(target),
                     found=str(by) if by else "",
                     hint="what it wrote is there, untouched; look at it, then choose another "
                          "name, or give the same command again")  # fmt: skip


def real_path(target: Path) -> Path:
    """The target behind all links. Raises: StorageError for links in a circle."""
    path = Path(os.path.realpath(target))
    if path.is_symlink():
        raise StorageError("links that lead nowhere", where=str(target),
                           hint="choose another name, or mend the links")  # fmt: skip
    return path


def _take(
    lock: Path, target: Path, me: Holder, deadline: float, kept: str
) -> tuple[int, Holder | None]:
    """The open lock file, once it is this process's, and who had it before."""
    began, before = time.monotonic(), None
    while True:
        try:
            flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
            handle = os.open(lock, flags, 0o666)
        except FileExistsError:
            is_free, other = _look_at(lock, target)
            before = other or before
            if is_free:
                continue
            now = time.monotonic()
            # Whoever has just made the file takes a moment to say who it is.
            if now >= deadline and (other is not None or now >= began + _INTRODUCTION_S):
                raise _busy(lock, target, other, kept) from None
            time.sleep(_POLL_S)
            continue
        try:
            # Before it was locked, it looked like one that was left behind, and may be gone.
            is_mine = _flock(handle, lock) is not False and _is_at(handle, lock)
            if is_mine:
                os.write(handle, me.encoded())
        except BaseException:  # a full disk, a signal
            with suppress(OSError):
                if _flock(handle, lock) is not False:  # else another process is at it
                    _unlink_own(lock, handle)
            os.close(handle)
            raise
        if is_mine:
            return handle, before
        os.close(handle)


def _unlink_own(lock: Path, handle: int) -> None:
    with suppress(OSError):
        if _is_at(handle, lock):
            lock.unlink()


def _look_at(lock: Path, target: Path) -> tuple[bool, Holder | None]:
    """Whether the lock is free now, else who holds it; removes one that was left behind.

    Raises: StorageError for a file that is no lock.
    """
    flags = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        try:
            handle = os.open(lock, flags | os.O_RDWR)
        except PermissionError:  # another user's
            handle = os.open(lock, flags | os.O_RDONLY)
    except FileNotFoundError:
        return True, None
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.EISDIR):
            found = "a link" if error.errno == errno.ELOOP else "a folder"
            raise _in_the_way(lock, found) from error
        raise
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise _in_the_way(lock, "no file")
        locked = _flock(handle, lock)
        try:
            other = read_holder(handle)
        except ValueError as error:
            raise _in_the_way(lock, str(error)) from error
        if locked is False:
            return False, other
        if locked is None and (other is None or other.may_live):
            return False, other
        if _is_at(handle, lock):
            if other is not None:
                _sweep(target, other.token)
            _remove(lock, handle, alone=bool(locked))
        return True, None
    finally:
        os.close(handle)


def _remove(lock: Path, handle: int, alone: bool) -> None:
    """Delete the lock file that was left behind, and not a new one that just took its place."""
    if alone:
        lock.unlink(missing_ok=True)
        return
    aside = lock.with_name(f"{lock.name}.{Holder.me().token}")
    with suppress(FileNotFoundError):  # another one was quicker
        lock.rename(aside)
        if not _is_at(handle, aside):
            with suppress(OSError):
                os.link(aside, lock)
        aside.unlink()


def _covers(held: Path, path: Path) -> bool:
    """Whether `path` is in what is held, or in or itself something that is named after it."""
    return any(
        place.parent == held.parent and f"{place.name}.".startswith(f"{held.name}.")
        for place in (path, *path.parents)
    )


def _sweep(target: Path, token: str) -> None:
    """Remove the temporary files of a killed process that held `target`."""
    name = glob.escape(target.name)
    left = [target.with_name(f".{target.name}.{token}.tmp")]
    left += target.parent.glob(f".{name}.*.{token}.tmp")
    for folder in (target, *target.parent.glob(f"{name}.*")):
        if folder.is_dir() and not folder.is_symlink():
            left += folder.rglob(f".*.{token}.tmp")
    for path in left:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _flock(handle: int, lock: Path) -> bool | None:
    """Whether the lock was free and is taken; None where the file system has none."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        device = os.fstat(handle).st_dev
        if device not in _told:
            _told.add(device)
            _log.warning(
                "%s: this file system has no locks; the file %s stands for one. If a process is "
                "killed on another machine, delete that file by hand", lock.parent, lock.name,
            )  # fmt: skip
        return None
    return True


def _is_at(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.lstat(path))
    except FileNotFoundError:
        return False


def _busy(lock: Path, target: Path, other: Holder | None, kept: str) -> BusyError:
    who = str(other) if other else "a process that does not say who it is"
    end = f", or end it with `kill {quoted(other.pid)}`" if other and other.is_here else ""
    hint = f"wait for it{end}" + (f"; {kept}" if kept else "")
    if other is None or not other.is_here:
        hint += f"; if it is gone, delete {lock}"
    return BusyError("another process writes it", where=str(target), found=who, hint=hint)


def _in_the_way(lock: Path, found: str) -> StorageError:
    return StorageError("something is in the place of the lock", where=str(lock), found=found,
                        hint="move it away, it is not ours")  # fmt: skip
