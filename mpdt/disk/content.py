"""Content: bytes that are on the disk itself, room for them, and their SHA-256."""

from __future__ import annotations

import errno
import hashlib
import os
import resource
import shutil
from pathlib import Path
from typing import BinaryIO


def sha256(file: Path | BinaryIO) -> str:
    """Of a whole file, in hexadecimal; of an open one from where it stands. Raises: OSError."""
    if isinstance(file, Path):
        with file.open("rb") as stream:
            return sha256(stream)
    return hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]


def sync(path: Path) -> None:
    """Flush a file or folder to the disk itself. Raises: OSError."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sync_tree(folder: Path) -> None:
    """Flush a folder and all files and folders below it. Raises: OSError."""
    for path in (*sorted(folder.rglob("*")), folder):
        if not path.is_symlink():
            sync(path)


def _look_for_room(path: Path, num_bytes: int, later: int) -> None:
    """HDF5 cannot close a file whose last part the disk refused, and takes the process with it."""
    free = shutil.disk_usage(path.parent).free + path.stat().st_blocks * 512
    most, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
    if most != resource.RLIM_INFINITY:
        free = min(free, most)
    if free < num_bytes + later:
        raise OSError(errno.ENOSPC, f"No space left: {num_bytes + later} bytes needed, {free} free")


def reserve(path: Path, num_bytes: int, later: int = 0) -> None:
    """Claim the blocks of a file before anything long is written into it.

    A full disk is then known at once and as one clean error, not in the middle of a flush.

    Args:
        later: bytes that will come behind them: looked for, not claimed.
    Raises: OSError where there is no room.
    """
    if later:
        _look_for_room(path, num_bytes, later)
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
