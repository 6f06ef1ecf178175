"""Opening: the HDF5 file behind a path, if it is ours; every failure is one clear error."""

from __future__ import annotations

import os
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import h5py
import numpy as np

from mpdt.data.store import layout
from mpdt.data.store.origin import damaged_hint, missing_hint
from mpdt.data.store.tree import Tree
from mpdt.disk import Seen
from mpdt.errors import FormatError, MissingFileError, MpdtError, StorageError, UsageError
from mpdt.reading import HEAD_BYTES, open_plain, told_by


class Source:
    """A file that stays open, so that what was opened is what is read, whatever takes its place.

    Its path names the file itself where the system has /proc; elsewhere it is looked at again, and
    another file is refused.
    """

    def __init__(self, path: Path, stream: BinaryIO) -> None:
        self.path, self.seen = path, Seen.of(os.fstat(stream.fileno()))
        self._handle = os.dup(stream.fileno())
        weakref.finalize(self, os.close, self._handle)

    def __reduce__(self) -> tuple[object, ...]:
        return _open_again, (self.path, self.seen)

    def open(self) -> BinaryIO:
        """The bytes, to be closed by the caller. Raises: StorageError if it is another file now."""
        if (name := _proc_name(self._handle)) is not None:
            return name.open("rb")
        stream = open_plain(self.path)
        if Seen.of(os.fstat(stream.fileno())) != self.seen:
            stream.close()
            raise _replaced(self.path)
        return stream

    def expect_there(self) -> None:
        """For who reads by path as well. Raises: StorageError if another file is there now."""
        if Seen.at(self.path.resolve()) != self.seen:
            raise _replaced(self.path)


class Sources(Source):
    """Several files that are read as one."""

    def __init__(self, sources: Sequence[Source]) -> None:
        self._sources = tuple(sources)

    def __reduce__(self) -> tuple[object, ...]:
        return Sources, (self._sources,)

    def open(self) -> BinaryIO:
        raise UsageError("several files have no bytes as one",
                         hint="merge them: mpdt-data merge -h")  # fmt: skip

    def expect_there(self) -> None:
        for source in self._sources:
            source.expect_there()


def _open_again(path: Path, seen: Seen) -> Source:
    """In another process. Raises: StorageError if it is another file now."""
    with open_plain(path) as stream:
        source = Source(path, stream)
    if source.seen != seen:
        raise _replaced(path)
    return source


def _proc_name(handle: int) -> Path | None:
    """A name that leads to an open file even if its path leads elsewhere by now."""
    name = Path(f"/proc/self/fd/{handle}")
    return name if name.exists() else None


def _replaced(path: Path) -> StorageError:
    return StorageError("another file took its place since it was opened", where=str(path),
                        hint="the same command again reads the one that is there")  # fmt: skip


@dataclass(frozen=True, eq=False)
class Opened:
    """A file while it is open: what is in it, and its bytes."""

    tree: Tree
    stream: BinaryIO


@contextmanager
def opened(
    path: Path, unfinished: bool = False, source: Source | None = None, in_memory: bool = False
) -> Iterator[Opened]:
    """A complete mpdt/1 file that holds nothing but what the format knows, inside itself.

    Args:
        in_memory: read large tables instead of mapping them.
        source: what was opened under that path before, to be read instead of what is there now.
    Raises: as `open_dataset`; FormatError also for whatever cannot be read inside the context.
    """
    with _open(path, source) as (file, stream), _told_as_damage(path):
        tree = Tree(file, str(path))
        _check_header(file, path, unfinished)
        tree.check(stream, os.fstat(stream.fileno()).st_size)
        if not in_memory:
            tree.map_large(stream)
        yield Opened(tree, stream)


# What h5py and numpy raise about metadata that makes no sense, found by flipping bytes.
_DAMAGE = (
    OSError, RuntimeError, ValueError, TypeError, KeyError, IndexError, AttributeError,
    OverflowError, MemoryError, NotImplementedError,
)  # fmt: skip


@contextmanager
def _told_as_damage(path: Path) -> Iterator[None]:
    """The file opened, so whatever cannot be read in it is damage: one FormatError for all."""
    try:
        yield
    except MpdtError:
        raise
    except _DAMAGE as error:
        raise FormatError("damaged", where=str(path), found=f"{type(error).__name__}: {error}",
                          hint=damaged_hint(path)) from error  # fmt: skip


@contextmanager
def _open(path: Path, source: Source | None) -> Iterator[tuple[h5py.File, BinaryIO]]:
    where = str(path)
    try:
        stream = source.open() if source else open_plain(path)
    except MissingFileError as error:
        raise MissingFileError(error.what, where=where, found=error.found,
                               hint=error.hint or missing_hint(path)) from error  # fmt: skip
    with stream, _hdf5(path, stream) as file:
        yield file, stream


def _hdf5(path: Path, stream: BinaryIO) -> h5py.File:
    """The very file of `stream`, for the mapping shows that one, whatever is at `path` by now."""
    there = Seen.at(path.resolve())
    is_there = there == Seen.of(os.fstat(stream.fileno()))
    if is_there and not h5py.is_hdf5(path):
        stream.seek(0)
        what, hint = told_by(stream.read(HEAD_BYTES))
        raise FormatError("not an HDF5 file", where=str(path), found=what,
                          hint=hint or damaged_hint(path))  # fmt: skip
    try:
        if is_there:
            file = h5py.File(path, "r")
            if os.path.samestat(os.fstat(file.id.get_vfd_handle()), os.fstat(stream.fileno())):
                return file
            file.close()
        return h5py.File(stream, "r")  # through Python, which is slower
    except OSError as error:
        raise _refusal(path, error) from error


def _refusal(path: Path, error: OSError) -> FormatError | StorageError:
    text = str(error)
    if "truncated" in text or "signature" in text or "superblock" in text:
        return FormatError("truncated or damaged", where=str(path), found=text,
                           hint=damaged_hint(path))  # fmt: skip
    hint = "on a network disk, set HDF5_USE_FILE_LOCKING=FALSE" if "lock" in text else ""
    return StorageError("cannot be opened", where=str(path), found=text, hint=hint)


def _check_header(file: h5py.File, path: Path, unfinished: bool = False) -> None:
    where = str(path)
    name, _, major = str(file.attrs.get("format", "")).partition("/")
    if name != "mpdt":
        raise FormatError("an HDF5 file, but not one of mpdt", where=where,
                          expected=f"format {layout.FORMAT}", found=f"format '{name}'")  # fmt: skip
    if f"{name}/{major}" != layout.FORMAT:
        raise FormatError("another format version", where=where, expected=layout.FORMAT,
                          found=f"mpdt/{major}",
                          hint=f"an mpdt release that writes mpdt/{major} reads it")  # fmt: skip
    complete = file.attrs.get("complete", 0)
    if not unfinished and not (np.ndim(complete) == 0 and complete == 1):
        raise FormatError("incomplete: its writer was stopped", where=where,
                          hint=damaged_hint(path))  # fmt: skip
