"""What the operating system says about a disk, as errors a user can mend."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mpdt.errors import MpdtError, StorageError


def write_atomically(path: Path, content: bytes) -> None:
    """Write a small file completely or not at all. Raises: StorageError."""
    temporary = path.with_name(path.name + ".tmp")
    with storage_errors(path):
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)


@contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Turn what the operating system says about a disk into a StorageError about `path`."""
    try:
        yield
    except MpdtError:
        raise
    except OSError as error:
        reasons = {
            errno.ENOSPC: ("the disk is full", "free some space, then run the same command again"),
            errno.EDQUOT: ("the disk quota is used up", "free some space, then run it again"),
            errno.EROFS: ("the file system is read-only", "choose another place with -o"),
            errno.EACCES: ("no permission to write here", "choose another place with -o"),
            errno.EPERM: ("no permission to write here", "choose another place with -o"),
            errno.ENOENT: ("the folder does not exist", f"create it: mkdir -p {path.parent}"),
            errno.ENOTDIR: ("a file stands where a folder should", "choose another place with -o"),
        }
        what, hint = reasons.get(error.errno or 0, (f"the disk refused: {error}", ""))
        raise StorageError(what, where=str(path), hint=hint) from error
