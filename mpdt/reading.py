"""Reading: what a user names is a plain file, and no larger than its kind needs.

A pipe, a socket or a device would hang whoever opens it, or never end. So the kind is looked at
before the file is opened, and again at what was opened. What the first bytes say a file is counts,
not its name.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Collection
from pathlib import Path
from typing import Any, BinaryIO

import msgspec

from mpdt.errors import FormatError, MissingFileError, StorageError

TEXT_BYTES = 64 << 20
"""Of a file of text; the lock of 500 tasks has 1 MB."""

_KINDS = {
    stat.S_IFDIR: "a folder", stat.S_IFIFO: "a named pipe", stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device", stat.S_IFBLK: "a device",
}  # fmt: skip

OWNER = "ask whoever owns it (ls -ld shows who)"

MAX_NESTING = 50
"""Of JSON; ours is ten deep."""
HEAD_BYTES = 512
_ANOTHER = "take another copy of it"
_UNPACK, _FETCH = "unpack it first", "fetch the file itself first"
_HEADS: tuple[tuple[bytes, str, str], ...] = (
    (b"version https://git-lfs", "a git-lfs pointer", f"{_FETCH}: git lfs pull"),
    (b"/annex/objects/", "a git-annex pointer", f"{_FETCH}: git annex get"),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file", ""), (b"PAR1", "a Parquet file", ""),
    (b"\x93NUMPY", "an array of numpy (.npy)", ""), (b"%PDF", "a PDF file", ""),
    (b"\x89PNG", "a picture (PNG)", ""), (b"ARROW1", "an Arrow file", ""),
    (b"SQLite format 3", "an SQLite file", ""), (b"\x7fELF", "a program", ""),
    (b"PK\x03\x04", "a zip archive", _UNPACK), (b"PK\x05\x06", "an empty zip archive", ""),
    (b"\x1f\x8b", "a gzip file", f"{_UNPACK}: gunzip"), (b"BZh", "a bzip2 file", _UNPACK),
    (b"\xfd7zXZ\x00", "an xz file", _UNPACK), (b"\x28\xb5\x2f\xfd", "a zstd file", _UNPACK),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive", _UNPACK), (b"Rar!", "a rar archive", _UNPACK),
    *((b"\x80" + bytes([protocol]), "a pickle", "") for protocol in range(2, 6)),
)  # fmt: skip
_PAGES = ((b"<!doctype html", "an HTML page"), (b"<html", "an HTML page"), (b"<?xml", "XML"))
_PAGE_HINT = "a server's answer in place of the file: download it again"


def refuse_special(path: Path) -> os.stat_result:
    """What the system knows of the file at `path`, links followed.

    Raises: MissingFileError; FormatError for a folder, a pipe, a socket or a device; StorageError
        where the system refuses to look.
    """
    try:
        found = path.stat()
    except FileNotFoundError as error:
        raise missing(path) from error
    except (OSError, ValueError) as error:  # a loop of links, a name with NUL
        raise _closed(path, error) from error
    _refuse(path, found)
    return found


def refuse_closed(folder: Path) -> None:
    """Before a folder is searched: of one that the system will not list, `glob` says it is empty.

    Raises: StorageError.
    """
    try:
        os.scandir(folder).close()
    except OSError as error:
        raise _closed(folder, error) from error


def _closed(path: Path, error: OSError | ValueError) -> StorageError:
    hint = OWNER if isinstance(error, PermissionError) else ""
    return StorageError("cannot be opened", where=str(path), found=str(error), hint=hint)


def missing(path: Path, what: str = "no such file") -> MissingFileError:
    """The error for a path that leads to nothing; a link is told as one."""
    if path.is_symlink():
        return MissingFileError("a link that leads nowhere", where=str(path),
                                found=str(path.readlink()), hint="mend it, or move it away"
                                )  # fmt: skip
    return MissingFileError(what, where=str(path))


def open_plain(path: Path) -> BinaryIO:
    """Open a plain file for reading. Raises: as `refuse_special`."""
    refuse_special(path)
    try:
        # Should a pipe have taken its place meanwhile, this does not wait for its writer.
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError as error:
        raise missing(path) from error
    except OSError as error:
        raise _closed(path, error) from error
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


def decode_json(text: str | bytes, wide: Collection[str] = ()) -> Any:
    """JSON as its standard has it: no NaN, no number that is none, no half of a character; and
    no whole number that no array has room for.

    Args:
        wide: names in an object at the top whose numbers may be larger, such as seeds.
    Raises: ValueError, also for what is nested deeper than `MAX_NESTING`.
    """
    try:
        value = msgspec.json.decode(text)
    except RecursionError as error:
        raise ValueError(f"nested deeper than {MAX_NESTING}") from error
    layer = [value]
    if wide and isinstance(value, dict):
        layer = [{key: one for key, one in value.items() if key not in wide}]
    for _ in range(MAX_NESTING):
        if any(isinstance(one, int) and one.bit_length() > 63 for one in layer):
            raise ValueError("a whole number of more than 64 bits")
        layer = [
            item for one in layer if isinstance(one, dict | list)
            for item in (one.values() if isinstance(one, dict) else one)
        ]  # fmt: skip
        if not layer:
            return value
    raise ValueError(f"nested deeper than {MAX_NESTING}")


def read_json(path: Path, wide: Collection[str] = ()) -> dict[str, Any]:
    """The object in a file of JSON.

    Args:
        wide: as of `decode_json`.
    Raises: MissingFileError; FormatError for anything else; StorageError.
    """
    content = read_plain(path)
    try:
        value = decode_json(content, wide)
    except ValueError as error:
        raise FormatError("not JSON", where=str(path), found=str(error)[:120],
                          hint=_ANOTHER) from error  # fmt: skip
    if not isinstance(value, dict):
        raise FormatError("not a JSON object", where=str(path), found=type(value).__name__,
                          hint=_ANOTHER)  # fmt: skip
    return value


def told_by(head: bytes) -> tuple[str, str]:
    """What the first bytes of a file say it is, and what to do then; "" where they say nothing."""
    if not head:
        return "an empty file", "copy it again"
    for start, what, hint in _HEADS:
        if head.startswith(start):
            return what, hint
    if head[257:262] == b"ustar":
        return "a tar archive", _UNPACK
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    for start, what in _PAGES:
        if text.startswith(start):
            return what, _PAGE_HINT
    is_text = not set(head) - {*b"\t\n\r", *range(32, 127)}
    return ("text" if is_text else ""), ""


def refuse_other(path: Path, wanted: str, *known: str) -> None:
    """Look at the first bytes of a file before its format is tried.

    Args:
        wanted: what it ought to be, for the error.
        known: as `told_by` calls it; what the bytes do not tell passes too.
    Raises: FormatError saying what it is; as `open_plain`.
    """
    with open_plain(path) as stream:
        try:
            what, hint = told_by(stream.read(HEAD_BYTES))
        except OSError as error:
            raise StorageError("cannot be read", where=str(path), found=str(error)) from error
    if what and what not in known:
        raise FormatError(f"not {wanted}", where=str(path), found=what, hint=hint)


def _refuse(path: Path, found: os.stat_result) -> None:
    kind = stat.S_IFMT(found.st_mode)
    if kind != stat.S_IFREG:
        hint = "name a file in it" if kind == stat.S_IFDIR else "copy what it gives into a file"
        raise FormatError(f"{_KINDS.get(kind, 'something else')}, not a file", where=str(path),
                          hint=hint)  # fmt: skip
