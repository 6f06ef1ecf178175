"""Folders: find the files of an import, and a place for an export."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from mpdt.disk import expect_folder
from mpdt.errors import DataError
from mpdt.reading import missing, refuse_special

_SUMS = "SHA256SUMS"  # beside whatever `mpdt-data pull` brought


def files_below(paths: Sequence[Path], *suffixes: str) -> list[Path]:
    """The given files, and those with one of `suffixes` anywhere below the given folders.

    Links are followed, to a folder once.

    Raises: MissingFileError, also for a link that leads nowhere; FormatError for a pipe, socket or
        device of that name.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            found += [one for one in _below(path, set()) if one.suffix in suffixes]
        elif path.exists():
            found.append(path)
        else:
            raise missing(path, "no such file or folder")
    for path in found:
        refuse_special(path)
    return found


def left_out(paths: Sequence[Path], read: Iterable[Path]) -> list[str]:
    """A remark on what lies below the given folders and is none of the files that are read."""
    known = set(read)
    others = [
        path for folder in paths if folder.is_dir() for path in _below(folder, set())
        if path not in known and path.name != _SUMS
    ]  # fmt: skip
    more = f" and {len(others) - 3:,} more" if len(others) > 3 else ""
    return [f"left out {', '.join(map(str, others[:3]))}{more}: not of this format"] * bool(others)


def _below(folder: Path, seen: set[tuple[int, int]]) -> Iterator[Path]:
    place = folder.stat()
    if (place.st_dev, place.st_ino) in seen:
        return
    seen.add((place.st_dev, place.st_ino))
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            yield from _below(path, seen)
        elif path.is_symlink() and not path.exists():
            raise missing(path)
        else:
            yield path


def refuse_existing(target: Path) -> None:
    """Raises: DataError if something is at `target`; StorageError if it has no folder to be in."""
    if target.exists():
        raise DataError("an export would replace something", where=str(target),
                        hint="choose another name with -o, or move it away first")  # fmt: skip
    expect_folder(target.parent)
