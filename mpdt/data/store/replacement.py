"""Replace a file all at once or not at all."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mpdt.errors import MpdtError, StorageError

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Yield `<target>.tmp`; on a clean exit make it durable and rename it to `target`.

    On any exception the temporary file goes away and `target` stays what it was. A kill
    leaves the temporary file behind, which the next writer overwrites.

    Raises: StorageError where the disk refuses.
    """
    temporary = target.with_name(target.name + ".tmp")
    with disk(target):
        if not target.parent.is_dir():
            raise StorageError("folder does not exist", where=str(target.parent),
                               hint=f"mkdir -p {target.parent}")  # fmt: skip
        if target.is_dir():
            raise StorageError("a folder is in the way", where=str(target))
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
        code = error.errno if isinstance(error, OSError) else None
        full = code in _FULL or "No space left" in str(error) or "File too large" in str(error)
        hint = "make room there, or choose another folder with -o" if full else ""
        what = "the disk is full" if full else "cannot be written"
        raise StorageError(what, where=str(target), found=str(error), hint=hint) from error


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
