"""Content: bytes that are on the disk itself, room for them, and their SHA-256."""

from __future__ import annotations

import errno
import hashlib
import os
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
