"""Replace: a file or folder is there all at once or not at all, and nothing else is lost.

hold the target -> write beside it -> onto the disk -> is the target what it was? -> rename
"""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mpdt.disk.content import sync, sync_tree
from mpdt.disk.hold import Hold, Seen, holding, written_meanwhile
from mpdt.disk.refusal import disk
from mpdt.errors import StorageError

_HEAD_BYTES = 64
_NO_LINKS = {errno.EPERM, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EMLINK}
_NO_SUCH_RENAME = _NO_LINKS | {errno.EINVAL}
_HERE, _NOREPLACE = -100, 1  # AT_FDCWD and RENAME_NOREPLACE of Linux
_last: list[tuple[Path, Path, Seen | None]] = []
"""What was put at its place last: the target as named, behind all links, and what was put."""


@contextmanager
def replacing(target: Path, *, amends: bool = False, like: bytes = b"") -> Iterator[Path]:
    """Yield an empty file beside `target`; on a clean exit it is on the disk and takes its place.

    A link stays a link, the file it leads to is replaced; mode and group stay. On any exception
    the new file goes away and `target` stays what it was; after a kill the next writer of
    `target` takes it away.

    Args:
        amends: as in `holding`.
        like: what the first bytes of a file hold that may be replaced; "" = any file. A page or
            picture that somebody may have named after the data replaces its own kind alone.
    Raises: BusyError if another process holds `target` or wrote it since it was looked at;
        StorageError where the disk refuses, and for a file of another kind.
    """
    with holding(target, amends=amends) as hold:
        _check_kind(hold.path, target, like)
        with _beside(hold, target, _make_file, _remove_file) as temporary:
            yield temporary
            put_file(temporary, target)


@contextmanager
def appearing(target: Path) -> Iterator[Path]:
    """Yield an empty folder beside `target`; on a clean exit it is on the disk and renamed.

    Raises: BusyError if something is at `target` or another process holds it; StorageError.
    """
    with holding(target) as hold:
        if hold.found is not None:
            raise written_meanwhile(target)
        with _beside(hold, target, Path.mkdir, _remove_folder) as temporary:
            with disk(target):
                yield temporary
            put_folder(temporary, target)


@contextmanager
def _beside(
    hold: Hold, target: Path, make: Callable[[Path], None], remove: Callable[[Path], None]
) -> Iterator[Path]:
    """The name beside the target, made here and gone on any exception, whenever that comes.

    One that is there already is of a call around this one, and stays.
    """
    is_ours = True
    _last.clear()
    try:
        with disk(target):
            try:
                make(hold.temporary)
            except FileExistsError:
                is_ours = False
                raise
        yield hold.temporary
    except BaseException:
        if is_ours:
            remove(hold.temporary)
        raise


def _make_file(path: Path) -> None:
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    os.close(os.open(path, flags, 0o666))


def _remove_file(path: Path) -> None:
    with suppress(OSError):
        path.unlink(missing_ok=True)


def _remove_folder(path: Path) -> None:
    shutil.rmtree(path, ignore_errors=True)


def write_bytes(
    target: Path, content: bytes, *, amends: bool = False, like: bytes = b""
) -> None:  # fmt: skip
    """The old file or the new one, never half of it. Args, Raises: as `replacing`."""
    with replacing(target, amends=amends, like=like) as temporary, disk(target):
        temporary.write_bytes(content)


def check_replaceable(target: Path, like: bytes = b"") -> None:
    """Try to write beside `target`, before the work whose result is to go there.

    Args, Raises: as `replacing`.
    """
    with holding(target, amends=True) as hold, disk(target):
        _check_kind(hold.path, target, like)
        with _beside(hold, target, _make_file, _remove_file) as temporary:
            temporary.unlink()


def _check_kind(path: Path, target: Path, like: bytes) -> None:
    """Raises: StorageError unless there is a file of that kind or nothing."""
    with disk(target):
        if path.is_dir():
            raise StorageError("a folder is in the way", where=str(target),
                               hint="choose another name, or move it away")  # fmt: skip
        if path.exists() and not path.is_file():
            raise StorageError("not a file, and nothing to replace", where=str(target),
                               found=stat.filemode(path.stat().st_mode),
                               hint="choose another name, or move it away")  # fmt: skip
        if like and path.exists():
            with path.open("rb") as file:
                head = file.read(_HEAD_BYTES)
            if head and like not in head:
                raise StorageError("would replace a file of another kind", where=str(target),
                                   hint="choose another name, or move it away")  # fmt: skip


def put_file(temporary: Path, target: Path) -> None:
    """The last step: a whole file beside the target takes its place, if that is what it was.

    Raises: as `replacing`; then `temporary` is still there.
    """
    with holding(target) as hold, disk(target):
        sync(temporary)
        if Seen.at(hold.path) != hold.found:
            raise written_meanwhile(target)
        _last[:] = [(target, hold.path, Seen.at(temporary))]
        if hold.found is None:
            _put_new(temporary, hold.path, target)
        else:
            _keep_owner(temporary, hold.path.stat())
            temporary.replace(hold.path)
        hold.found = Seen.at(hold.path)
        sync(hold.path.parent)


def put_folder(temporary: Path, target: Path) -> None:
    """The last step: a whole folder beside the target gets its name, if nothing has it.

    Raises: as `appearing`; then `temporary` is still there.
    """
    with holding(target) as hold, disk(target):
        sync_tree(temporary)
        if hold.found is not None or Seen.at(hold.path) is not None:
            raise written_meanwhile(target)
        _last[:] = [(target, hold.path, Seen.at(temporary))]
        try:
            temporary.rename(hold.path)  # replaces no file, and no folder that holds anything
        except OSError as error:
            if error.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
                raise written_meanwhile(target) from error
            raise
        hold.found = Seen.at(hold.path)
        sync(hold.path.parent)


def last_put() -> Path | None:
    """What this process put at its place last, if nothing was begun since; of a signal that came
    during the rename nobody else knows.
    """
    with suppress(OSError):
        return next((target for target, path, seen in _last if Seen.at(path) == seen), None)
    return None


def _put_new(temporary: Path, path: Path, target: Path) -> None:
    """To a name that is free. In one step where the system has it: a kill between the two others
    would leave both names.
    """
    try:
        try:
            _rename_new(temporary, path)
            return
        except OSError as error:
            if error.errno not in _NO_SUCH_RENAME:
                raise
        os.link(temporary, path)  # unlike a rename it replaces nothing
    except FileExistsError as error:
        raise written_meanwhile(target) from error
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        temporary.rename(path)
    else:
        temporary.unlink()


def _rename_new(old: Path, new: Path) -> None:
    """Raises: FileExistsError; OSError, with ENOSYS or EINVAL where there is no such call."""
    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if call is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    if call(_HERE, os.fsencode(old), _HERE, os.fsencode(new), _NOREPLACE) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), str(new))


def _keep_owner(temporary: Path, old: os.stat_result) -> None:
    """Group and mode of what is replaced, and its owner where that is allowed."""
    with suppress(PermissionError):
        os.chown(temporary, -1, old.st_gid)
    with suppress(PermissionError):
        os.chown(temporary, old.st_uid, -1)
    temporary.chmod(stat.S_IMODE(old.st_mode))
