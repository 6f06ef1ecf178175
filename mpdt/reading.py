"""Reading: what a user names is a plain file, and no larger than its kind needs.

A pipe, a socket or a device would hang whoever opens it, or never end. So the kind is looked at
before the file is opened, and again at what was opened.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO

from mpdt.errors import FormatError, MissingFileError, StorageError

TEXT_BYTES = 64 << 20
"""Of a file of text; the lock of 500 tasks has 1 MB."""

_KINDS = {
    stat.S_IFDIR: "a folder", stat.S_IFIFO: "a named pipe", stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device", stat.S_IFBLK: "a device",
}  # fmt: skip


def refuse_special(path: Path) -> os.stat_result:
    """What the system knows of the file at `path`, links followed.

    Raises: MissingFileError; FormatError for a folder, a pipe, a socket or a device; StorageError
        where the system refuses to look.
    """
    try:
        found = path.stat()
    except FileNotFoundError as error:
        raise MissingFileError("no such file", where=str(path)) from error
    except (OSError, ValueError) as error:  # a loop of links, a name with NUL
        raise StorageError("cannot be opened", where=str(path), found=str(error)) from error
    _refuse(path, found)
    return found


def open_plain(path: Path) -> BinaryIO:
    """Open a plain file for reading. Raises: as `refuse_special`."""
    refuse_special(path)
    try:
        # Should a pipe have taken its place meanwhile, this does not wait for its writer.
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError as error:
        raise MissingFileError("no such file", where=str(path)) from error
    except OSError as error:
        raise StorageError("cannot be opened", where=str(path), found=str(error)) from error
    stream = os.fdopen(handle, "rb")
    try:
        _refuse(path, os.fstat(handle))
    except BaseException:
        stream.close()
        raise
    return stream


def read_plain(path: Path, limit: int = TEXT_BYTES) -> bytes:
    """The bytes of a plain file of at most `limit` bytes.

    Raises: as `open_plain`; FormatError for a larger one.
    """
    with open_plain(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        try:
            content = b"" if size > limit else stream.read(limit + 1)
        except OSError as error:
            raise StorageError("cannot be read", where=str(path), found=str(error)) from error
    if max(size, len(content)) > limit:
        raise FormatError("larger than any file of its kind", where=str(path),
                          expected=f"at most {limit:,} bytes",
                          found=f"{max(size, len(content)):,}")  # fmt: skip
    return content


def _refuse(path: Path, found: os.stat_result) -> None:
    kind = stat.S_IFMT(found.st_mode)
    if kind != stat.S_IFREG:
        raise FormatError(f"{_KINDS.get(kind, 'something else')}, not a file", where=str(path))
