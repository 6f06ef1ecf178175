"""Book: measured data with its evidence, as a JSON file of one line per entry.

Two are shipped under `weights/`: mixing rates (`calibration.py`) and references
(`record.py`). The format is refused if it is another, and so is any unknown field.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Generic, TypeVar

import msgspec

from mpdt.data.spec.entry import canonical_json
from mpdt.disk import write_bytes
from mpdt.errors import DataError
from mpdt.reading import read_plain
from mpdt.version import installed

Entry = TypeVar("Entry")


def versions() -> dict[str, str]:
    """Of the packages that measured numbers depend on."""
    return installed(("metaworld", "mujoco", "numpy"))


class _Book(msgspec.Struct, Generic[Entry], frozen=True, forbid_unknown_fields=True):
    format: str
    rule: str
    entries: tuple[Entry, ...]


def read_book(path: Path, kind: type[Entry], format: str, what: str) -> tuple[Entry, ...]:
    """Entries of a file, in its order.

    Args:
        what: the file is one of, for the message.

    Raises: DataError for another content; FormatError for what is no file; StorageError.
    """
    content = read_plain(path)
    try:
        book = msgspec.json.decode(content, type=_Book[kind])  # type: ignore[valid-type]
    except (ValueError, RecursionError) as error:
        raise DataError(f"not a {what}", where=str(path), found=str(error),
                        hint="take another copy of it, or move it away") from error  # fmt: skip
    if book.format != format:
        raise DataError(f"another format of {what}", where=str(path), expected=format,
                        found=book.format)  # fmt: skip
    return book.entries


def write_book(path: Path, entries: Iterable[object], format: str, rule: str) -> None:
    """Write entries, one per line; `rule` tells readers how they were found. Atomic.

    Raises: StorageError where the disk refuses.
    """
    lines = ",\n".join(canonical_json(entry).decode() for entry in entries)
    head = f'{{"format":{json.dumps(format)},\n"rule":{json.dumps(rule)},\n"entries":[\n'
    write_bytes(path, f"{head}{lines}\n]}}\n".encode())
