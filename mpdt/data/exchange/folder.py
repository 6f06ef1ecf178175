"""Folders: find the files of an import, and let an export appear whole or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from mpdt.disk import disk, sync
from mpdt.errors import DataError, MissingFileError, StorageError
from mpdt.reading import refuse_special


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
            raise MissingFileError("no such file or folder", where=str(path))
    for path in found:
        refuse_special(path)
    return found


def _below(folder: Path, seen: set[tuple[int, int]]) -> Iterator[Path]:
    place = folder.stat()
    if (place.st_dev, place.st_ino) in seen:
        return
    seen.add((place.st_dev, place.st_ino))
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            yield from _below(path, seen)
        elif path.is_symlink() and not path.exists():
            raise MissingFileError("a link that leads nowhere", where=str(path),
                                   found=str(path.readlink()),
                                   hint="mend or delete it")  # fmt: skip
        else:
            yield path


@contextmanager
def appearing(target: Path) -> Iterator[Path]:
    """Yield an empty folder `<target>.tmp`; on a clean exit it is on the disk and renamed.

    On any exception it goes away. One left by a kill is replaced by the next export.

    Raises: DataError if there is something at `target`; StorageError where the disk refuses.
    """
    refuse_existing(target)
    temporary = target.with_name(target.name + ".tmp")
    with disk(target):
        if temporary.exists():
            shutil.rmtree(temporary)
        temporary.mkdir()
    try:
        with disk(target):
            yield temporary
            for path in (*sorted(temporary.rglob("*")), temporary):
                sync(path)
            temporary.rename(target)
            sync(target.parent)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def refuse_existing(target: Path) -> None:
    """Raises: DataError if something is at `target`; StorageError if it has no folder to be in."""
    if target.exists():
        raise DataError("an export would replace something", where=str(target),
                        hint="choose another name with -o, or delete it first")  # fmt: skip
    if not target.parent.is_dir():
        raise StorageError("folder does not exist", where=str(target.parent),
                           hint=f"mkdir -p {target.parent}")  # fmt: skip
