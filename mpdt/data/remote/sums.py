"""Sums: SHA-256 of what was sent, beside it, as `sha256sum -c` reads them; digests of its own.

x.h5        x.h5.sha256            one line
folder/     folder/SHA256SUMS      one line per file; last to be written, so it means whole
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import verify
from mpdt.disk import sha256
from mpdt.errors import DataError, FormatError
from mpdt.reading import missing, refuse_closed, refuse_special

SUFFIX = ".sha256"
FILE_NAME = "SHA256SUMS"
_LINE = re.compile(r"([0-9a-f]{64}) [ *](.+)")


def sums_of(source: Path) -> dict[str, str]:
    """SHA-256 by path: of the file, or of every file below the folder.

    Raises: MissingFileError; FormatError for a pipe, socket or device; DataError for an empty
        folder and for names that a line cannot hold; StorageError where the disk refuses.
    """
    if source.is_file():
        return {source.name: sha256(source)}
    if not source.exists():
        raise missing(source, "no such file or folder")
    if not source.is_dir():
        refuse_special(source)
    refuse_closed(source)
    below = sorted(source.rglob("*"))
    for path in below:
        # What a link leads to may be anything of this machine; a FIFO would never end.
        if path.is_symlink() or not (path.is_file() or path.is_dir()):
            raise DataError("a link or special file cannot be sent", where=str(path),
                            hint="put a copy in its place, or leave it out")  # fmt: skip
        if path.is_dir():
            refuse_closed(path)
    files = [path for path in below if path.is_file()]
    names = {path.relative_to(source).as_posix(): path for path in files}
    names.pop(FILE_NAME, None)
    if not names:
        raise DataError("an empty folder", where=str(source))
    for name in names:
        if not _is_plain(name):
            raise DataError("a file name that cannot be sent", where=str(source), found=name)
    return {name: sha256(path) for name, path in names.items()}


def dumped(sums: Mapping[str, str]) -> bytes:
    """As sha256sum writes them."""
    return "".join(f"{digest}  {name}\n" for name, digest in sums.items()).encode()


def loaded(content: bytes, where: str) -> dict[str, str]:
    """Raises: FormatError for other lines, and for names that lead out of the folder."""
    try:
        lines = [_LINE.fullmatch(line) for line in content.decode().splitlines()]
    except UnicodeDecodeError:
        lines = [None]
    found = {line[2]: line[1] for line in lines if line and _is_plain(line[2])}
    if not found or len(found) != len(lines):
        raise FormatError("not a list of SHA-256 sums", where=where,
                          expected="lines of 64 hex digits, two spaces, a path below it",
                          found=content[:60].decode(errors="replace").strip())  # fmt: skip
    return found


def _is_plain(name: str) -> bool:
    path = PurePosixPath(name)
    # Our own: `.part` files, and the list itself.
    ours = path.suffix == ".part" or name == FILE_NAME
    odd = "\\" in name or not name.isprintable() or name != str(path)
    return not (path.is_absolute() or ".." in path.parts or odd or ours)


def prove(path: Path, lock: Path | None = None) -> str:
    """The content hash of a file all of whose bytes are covered by a digest or the seal.

    Args:
        lock: only what this datasets.lock holds will do.
    Raises: DataError saying what is wrong; MissingFileError, StorageError.
    """
    report = verify(path, only=("hash",), lock=lock)
    for finding in report.findings:
        if finding.outcome is Outcome.FAIL:
            raise DataError("not a whole dataset file", where=str(path),
                            found="; ".join(finding.lines()), hint=finding.hint)  # fmt: skip
    return report.content_hash
