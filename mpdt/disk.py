"""Replace a file all at once or not at all, and say clearly what the disk refuses."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mpdt.errors import MpdtError, StorageError

# HDF5 often keeps the text of an error only, hence both.
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_FULL_TEXTS = ("No space left", "File too large")
_READ_ONLY, _READ_ONLY_TEXT = errno.EROFS, "Read-only file system"
_FORBIDDEN = {errno.EACCES, errno.EPERM}
_FORBIDDEN_TEXTS = ("Permission denied", "Operation not permitted")


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Yield `<target>.tmp`; on a clean exit make it durable and rename it to `target`.

    On any exception the temporary file goes away and `target` stays what it was. A kill
    leaves the temporary file behind, which the next writer overwrites.

    Raises: StorageError where the disk refuses.
    """
    temporary = target.with_name(target.name + ".tmp")
    _check_place(target)
    try:
        yield temporary
        with disk(target):
            sync(temporary)
            temporary.replace(target)
            sync(target.parent)
    except BaseException:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise


def check_replaceable(target: Path) -> None:
    """Try to write beside `target`, before the work whose result is to go there.

    Raises: StorageError where `replacing` would.
    """
    _check_place(target)
    temporary = target.with_name(target.name + ".tmp")
    with disk(target):
        temporary.touch()
        temporary.unlink()


def _check_place(target: Path) -> None:
    with disk(target):
        if not target.parent.is_dir():
            raise StorageError("folder does not exist", where=str(target.parent),
                               hint=f"mkdir -p {target.parent}")  # fmt: skip
        if target.is_dir():
            raise StorageError("a folder is in the way", where=str(target),
                               hint="choose another name with -o")  # fmt: skip


@contextmanager
def disk(target: Path) -> Iterator[None]:
    """Turn what the system and HDF5 raise about writing `target` into StorageError.

    HDF5 reports a failed write as OSError or RuntimeError, depending on the layer.
    """
    try:
        yield
    except MpdtError:
        raise
    except (OSError, RuntimeError) as error:
        what, hint = _explain(error)
        raise StorageError(what, where=str(target), found=str(error), hint=hint) from error


def _explain(error: OSError | RuntimeError) -> tuple[str, str]:
    """What is wrong, and what to do next."""
    code, text = getattr(error, "errno", None), str(error)
    if code in _FULL or any(part in text for part in _FULL_TEXTS):
        return "the disk is full", "make room there, or choose another folder with -o"
    if code == _READ_ONLY or _READ_ONLY_TEXT in text:
        return "the disk is read-only", "choose another folder with -o"
    if code in _FORBIDDEN or any(part in text for part in _FORBIDDEN_TEXTS):
        return "no permission to write", (
            "choose another folder with -o, or ask whoever owns it (ls -ld shows who)"
        )
    return "cannot be written", "choose another folder or name with -o"


def sync(path: Path) -> None:
    """Flush a file or folder to the disk itself."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def reserve(path: Path, num_bytes: int) -> None:
    """Claim the blocks of a file before anything long is written into it.

    A full disk is then known at once and as one clean error, not in the middle of a flush.

    Raises: OSError where there is no room.
    """
    if not hasattr(os, "posix_fallocate"):  # macOS
        free = shutil.disk_usage(path.parent).free
        if free < num_bytes:
            raise OSError(errno.ENOSPC, f"No space left: {num_bytes} bytes needed, {free} free")
        return
    handle = os.open(path, os.O_RDWR)
    try:
        if num_bytes:
            os.posix_fallocate(handle, 0, num_bytes)
    except OSError as error:
        if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL):
            raise
    finally:
        os.close(handle)
