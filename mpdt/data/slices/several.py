"""What a reference names: one file, or several that are read as one.

    a.h5            the file                     parts/       every *.h5 in the folder
    a.h5,b.h5       both, in this order          parts/*.h5   those that fit, by name
    ...:expert      a slice of it all

A path that exists is meant by its whole name, whatever is in it.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from glob import has_magic
from pathlib import Path

from mpdt.data.slices.join import join
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset, parse_ref
from mpdt.errors import MissingFileError, UsageError
from mpdt.reading import refuse_closed, refuse_special

SUFFIX = ".h5"


def open_files(path: Path | str | Sequence[Path | str], preload: bool = False) -> Dataset:
    """The dataset that a path or several paths name, without a slice.

    Raises: MissingFileError where a folder or a pattern has no file; as `open_dataset` and `join`.
    """
    if isinstance(path, bytes):
        path = os.fsdecode(path)
    words = [path] if isinstance(path, str | Path) else list(path)
    if not words or "" in words:  # an empty word would be this folder
        raise UsageError("no file named", expected="at least one")
    files = [file for word in words for file in _files(Path(word))]
    parts = [open_dataset(file, preload) for file in files]
    if len(parts) == 1:
        return parts[0]
    return join(parts, Path(",".join(map(str, words))))


def open_ref(ref: Path | str | Sequence[Path | str]) -> tuple[Dataset, str | None]:
    """The dataset that FILE or FILE:slice names, and the name of the slice.

    Raises: as `open_files`; UsageError as `one_ref`.
    """
    path, name = parse_ref(str(ref) if isinstance(ref, str | Path) else one_ref(ref))
    return open_files(path), name


def one_ref(words: Sequence[Path | str]) -> str:
    """Several references as one.

    Raises: UsageError unless all name the same slice, or none; for a comma in one of several,
        which stands between names.
    """
    found = [parse_ref(str(word)) for word in words]
    if len(found) == 1:
        return str(words[0])
    names = {name for _, name in found}
    if len(names) != 1:
        raise UsageError("one slice is chosen of all files together",
                         where=" ".join(map(str, words)),
                         expected="the same :SLICE behind each, or behind none",
                         found=", ".join(sorted(name or "none" for name in names)))  # fmt: skip
    for path, _ in found:
        if "," in str(path) and path.exists():
            raise UsageError("a comma in its name", where=str(path),
                             hint="name several files by a pattern or their folder")  # fmt: skip
    name = names.pop()
    return ",".join(str(path) for path, _ in found) + (f":{name}" if name else "")


def _files(path: Path) -> list[Path]:
    """The files that one word means."""
    if path.is_dir():
        refuse_closed(path)
        found = _plain(path.glob(f"*{SUFFIX}"))
        if not found:
            raise MissingFileError(f"no {SUFFIX} file in this folder", where=str(path),
                                   hint="make one: mpdt-data list shows what can be made",
                                   )  # fmt: skip
        return found
    if path.exists():
        return [path]
    word = str(path)
    if has_magic(word):
        root = Path(path.anchor)
        found = _plain(root.glob(str(path.relative_to(path.anchor))))
        if not found:
            raise MissingFileError("no file fits", where=word)
        return found
    words = [one for one in word.split(",") if one]
    if "," in word and words:
        return [file for one in words for file in _files(Path(one))]
    return [path]


def _plain(paths: Iterable[Path]) -> list[Path]:
    """All but folders, in order: none is left out without a word.

    Raises: MissingFileError for a link to nowhere; FormatError for a pipe, socket or device.
    """
    found = sorted(one for one in paths if not one.is_dir())
    for one in found:
        refuse_special(one)
    return found
