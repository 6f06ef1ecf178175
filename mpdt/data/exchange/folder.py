"""Folders: find the files of an import, and a place for an export."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mpdt.errors import DataError, MissingFileError, StorageError


def files_below(paths: Sequence[Path], *suffixes: str) -> list[Path]:
    """The given files, and those with one of `suffixes` anywhere below the given folders.

    Raises: MissingFileError.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            found += sorted(p for p in path.rglob("*") if p.suffix in suffixes and p.is_file())
        elif path.exists():
            found.append(path)
        else:
            raise MissingFileError("no such file or folder", where=str(path))
    return found


def refuse_existing(target: Path) -> None:
    """Raises: DataError if something is at `target`; StorageError if it has no folder to be in."""
    if target.exists():
        raise DataError("an export would replace something", where=str(target),
                        hint="choose another name with -o, or delete it first")  # fmt: skip
    if not target.parent.is_dir():
        raise StorageError("folder does not exist", where=str(target.parent),
                           hint=f"mkdir -p {target.parent}")  # fmt: skip
