"""Replace: a file or folder is there all at once or not at all, and nothing else is lost.

hold the target -> write beside it -> onto the disk -> is the target what it was? -> rename
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mpdt.disk.content import sync, sync_tree
from mpdt.disk.hold import Hold, Seen, holding, real_path, written_meanwhile
from mpdt.disk.refusal import disk
from mpdt.errors import StorageError

_NO_LINKS = {errno.EPERM, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EMLINK}


@contextmanager
def replacing(target: Path, *, amends: bool = False) -> Iterator[Path]:
    """Yield an empty file beside `target`; on a clean exit it is on the disk and takes its place.

    A link stays a link, the file it leads to is replaced; mode and group stay. On any exception
    the new file goes away and `target` stays what it was; after a kill the next writer of
    `target` takes it away.

    Args:
        amends: as in `holding`.
    Raises: BusyError if another process holds `target` or wrote it since it was looked at;
        StorageError where the disk refuses.
    """
    _check_place(target)
    with holding(target, amends=amends) as hold:
        temporary = hold.temporary
        with disk(target):
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
            os.close(os.open(temporary, flags, 0o666))
        try:
            yield temporary
            with disk(target):
                sync(temporary)
                _put_file(hold, temporary, target)
        except BaseException:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise


@contextmanager
def appearing(target: Path) -> Iterator[Path]:
    """Yield an empty folder beside `target`; on a clean exit it is on the disk and renamed.

    Raises: BusyError if something is at `target` or another process holds it; StorageError.
    """
    with holding(target) as hold:
        temporary = hold.temporary
        with disk(target):
            temporary.mkdir()
        try:
            with disk(target):
                yield temporary
                sync_tree(temporary)
                if hold.found is not None or Seen.at(hold.path) is not None:
                    raise written_meanwhile(target)
                try:
                    # Never replaces a file, nor a folder that holds anything.
                    temporary.rename(hold.path)
                except OSError as error:
                    if error.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
                        raise written_meanwhile(target) from error
                    raise
                sync(hold.path.parent)
                hold.found = Seen.at(hold.path)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise


def write_bytes(target: Path, content: bytes, *, amends: bool = False) -> None:
    """The old file or the new one, never half of it. Raises: as `replacing`."""
    with replacing(target, amends=amends) as temporary, disk(target):
        temporary.write_bytes(content)


def check_replaceable(target: Path) -> None:
    """Try to write beside `target`, before the work whose result is to go there.

    Raises: as `replacing`.
    """
    _check_place(target)
    with holding(target, amends=True) as hold, disk(target):
        hold.temporary.touch(exist_ok=False)
        hold.temporary.unlink()


def _check_place(target: Path) -> None:
    with disk(target):
        path = real_path(target)
        if not path.parent.is_dir():
            raise StorageError("folder does not exist", where=str(target.parent),
                               hint=f"mkdir -p {target.parent}")  # fmt: skip
        if path.is_dir():
            raise StorageError("a folder is in the way", where=str(target),
                               hint="choose another name with -o")  # fmt: skip
        if path.exists() and not path.is_file():
            raise StorageError("not a file, and nothing to replace", where=str(target),
                               found=stat.filemode(path.stat().st_mode),
                               hint="choose another name with -o")  # fmt: skip


def _put_file(hold: Hold, temporary: Path, target: Path) -> None:
    """The last step: `temporary` becomes the target if that still is what it was."""
    if Seen.at(hold.path) != hold.found:
        raise written_meanwhile(target)
    if hold.found is None:
        _put_new(temporary, hold.path, target)
    else:
        _keep_owner(temporary, hold.path.stat())
        temporary.replace(hold.path)
    hold.found = Seen.at(hold.path)
    sync(hold.path.parent)


def _put_new(temporary: Path, path: Path, target: Path) -> None:
    try:
        os.link(temporary, path)  # unlike a rename it replaces nothing
    except FileExistsError as error:
        raise written_meanwhile(target) from error
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        temporary.rename(path)
    else:
        temporary.unlink()


def _keep_owner(temporary: Path, old: os.stat_result) -> None:
    """Group and mode of what is replaced, and its owner where that is allowed."""
    with suppress(PermissionError):
        os.chown(temporary, -1, old.st_gid)
    with suppress(PermissionError):
        os.chown(temporary, old.st_uid, -1)
    temporary.chmod(stat.S_IMODE(old.st_mode))
