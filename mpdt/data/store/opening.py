"""Opening: the HDF5 file behind a path, if it is ours; every failure is one clear error."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import h5py

from mpdt.data.store import layout
from mpdt.data.store.origin import damaged_hint, missing_hint
from mpdt.data.store.tree import Tree
from mpdt.errors import FormatError, MissingFileError, MpdtError, StorageError
from mpdt.reading import open_plain


@dataclass(frozen=True, eq=False)
class Opened:
    """A file while it is open: what is in it, and its bytes."""

    tree: Tree
    stream: BinaryIO


@contextmanager
def opened(path: Path, unfinished: bool = False) -> Iterator[Opened]:
    """A complete mpdt/1 file that holds nothing but what the format knows, inside itself.

    Raises: as `open_dataset`; FormatError also for whatever cannot be read inside the context.
    """
    with _open(path) as (file, stream), _told_as_damage(path):
        tree = Tree(file, str(path))
        _check_header(file, path, unfinished)
        tree.check(stream, os.fstat(stream.fileno()).st_size)
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
def _open(path: Path) -> Iterator[tuple[h5py.File, BinaryIO]]:
    where = str(path)
    try:
        stream = open_plain(path)
    except MissingFileError as error:
        raise MissingFileError(error.what, where=where, hint=missing_hint(path)) from error
    with stream:
        if not h5py.is_hdf5(path):
            raise FormatError("not an HDF5 file", where=where, hint=damaged_hint(path))
        try:
            file = h5py.File(path, "r")
        except OSError as error:
            raise _refusal(path, error) from error
        with file:
            # The mapping must show the very file h5py looked at, even if the path was replaced.
            if not os.path.samestat(os.fstat(stream.fileno()), path.stat()):
                raise StorageError("replaced while it was opened", where=where, hint="try again")
            yield file, stream


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
    if not unfinished and int(file.attrs.get("complete", 0)) != 1:
        raise FormatError("incomplete: its writer was stopped", where=where,
                          hint=damaged_hint(path))  # fmt: skip
