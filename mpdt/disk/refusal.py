"""Refusal: what a disk says when it will not, as one StorageError with what to do next."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mpdt.errors import MpdtError, StorageError, quoted
from mpdt.reading import OWNER

# HDF5 often keeps the text of an error only, hence both.
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_FULL_TEXTS = ("No space left", "File too large")
_READ_ONLY, _READ_ONLY_TEXT = errno.EROFS, "Read-only file system"
_FORBIDDEN = {errno.EACCES, errno.EPERM}
_FORBIDDEN_TEXTS = ("Permission denied", "Operation not permitted")


def expect_folder(folder: Path) -> None:
    """Raises: StorageError unless something can be put into `folder`."""
    if folder.is_dir():
        return
    existing = next((place for place in (folder, *folder.parents) if place.exists()), folder)
    if existing.exists() and not existing.is_dir():
        raise StorageError("a file is in the way", where=str(existing), expected="a folder",
                           hint="choose another folder or name")  # fmt: skip
    raise StorageError("the folder does not exist", where=str(folder),
                       hint=f"mkdir -p {quoted(folder)}")  # fmt: skip


def expect_room(target: Path, needed: int, what: str, option: str) -> None:
    """Before the work whose result is to go to `target`.

    Args:
        needed: bytes, in the folder of `target`.
        what: they are for.
        option: that chooses another place; "" = there is none.
    Raises: StorageError if there is less.
    """
    free = shutil.disk_usage(target.parent).free
    if free < needed:
        elsewhere = f", or choose another place with {option}" if option else ""
        raise StorageError(f"not enough room on the disk for {what}", where=str(target),
                           expected=f"{needed / 1e6:,.1f} MB free", found=f"{free / 1e6:,.1f} MB",
                           hint=f"free some space{elsewhere}")  # fmt: skip


def expect_rights(path: Path, grows: bool = False) -> None:
    """What is read, added to or put aside at the end would fail there, after hours of work.

    Args:
        grows: a file that is added to; others are replaced by their folder's rights.
    Raises: StorageError unless a file may be read, a folder emptied.
    """
    rights = os.R_OK | (os.W_OK if grows else 0)
    if path.is_dir():
        rights |= os.W_OK | os.X_OK
    if not os.access(path, rights):
        raise StorageError("no permission to use it", where=str(path), hint=OWNER)


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
        raise StorageError(what, where=str(target), found=_said(error), hint=hint) from error


def _said(error: OSError | RuntimeError) -> str:
    """What the system said; of HDF5's report of addresses and hidden names nothing else."""
    inner = re.search(r"errno = (\d+), error message = '([^']*)'", str(error))
    return f"[Errno {inner[1]}] {inner[2]}" if inner else str(error)


def _explain(error: OSError | RuntimeError) -> tuple[str, str]:
    """What is wrong, and what to do next."""
    code, text = getattr(error, "errno", None), str(error)
    if code in _FULL or any(part in text for part in _FULL_TEXTS):
        return "the disk is full", "make room there, or choose another folder"
    if code == _READ_ONLY or _READ_ONLY_TEXT in text:
        return "the disk is read-only", "choose another folder"
    if code in _FORBIDDEN or any(part in text for part in _FORBIDDEN_TEXTS):
        return "no permission to write", (
            "choose another folder, or ask whoever owns it (ls -ld shows who)"
        )
    return "cannot be written", "choose another folder or name, or move away what is there"
