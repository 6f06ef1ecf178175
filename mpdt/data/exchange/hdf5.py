"""HDF5 files of others: opened with one error for all damage, and arrays only of what is inside.

HDF5 can point elsewhere: external links and external storage read any file of the disk, and a
virtual dataset whose source is gone reads as zeros, without an error.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from mpdt.errors import FormatError, MissingFileError, MpdtError, StorageError

_MOST_COMPRESSED = 100
"""Numbers per stored one at most. Empty chunks take no place, so a shape may say anything."""
# What h5py and numpy raise about metadata that makes no sense.
_DAMAGE = (
    OSError, RuntimeError, ValueError, TypeError, KeyError, IndexError, AttributeError,
    OverflowError, MemoryError, NotImplementedError,
)  # fmt: skip


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """A foreign file for reading.

    Raises: MissingFileError; StorageError; FormatError for whatever cannot be read in it.
    """
    where = str(path)
    try:
        path.open("rb").close()
    except FileNotFoundError as error:
        raise MissingFileError("no such file", where=where) from error
    except OSError as error:
        raise StorageError("cannot be opened", where=where, found=str(error)) from error
    try:
        with h5py.File(path, "r") as file:
            yield file
    except MpdtError:
        raise
    except _DAMAGE as error:
        raise FormatError("damaged, or not an HDF5 file", where=where,
                          found=f"{type(error).__name__}: {error}"[:160]) from error  # fmt: skip


def member(group: h5py.Group, name: str, where: str) -> Any:
    """What is called `name` in the file itself.

    Raises: FormatError where it is missing or a link to another file.
    """
    for part in name.split("/"):
        link = group.get(part, getlink=True)
        if link is None:
            raise FormatError(f"no {name}", where=where)
        if isinstance(link, h5py.ExternalLink):
            raise FormatError(f"{name} is in another file", where=where, found=link.filename)
        group = group[part]
    return group


def array(
    group: h5py.Group, name: str, where: str, rows: tuple[int, int] | None = None
) -> NDArray[Any]:
    """A dataset of plain numbers, or `rows` of it.

    Raises: FormatError for a group, for text or objects, for numbers kept in other files, and
        for a virtual dataset whose source is not there or a size that no file has.
    """
    dataset = member(group, name, where)
    if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in "fiub":
        found = f"type {dataset.dtype}" if isinstance(dataset, h5py.Dataset) else "a group"
        raise FormatError(f"{name} is no array of numbers", where=where, found=found,
                          hint="observations of several parts are not supported"
                               if isinstance(dataset, h5py.Group) else "")  # fmt: skip
    if dataset.external:
        raise FormatError(f"{name} is in another file", where=where)
    if dataset.is_virtual:
        folder = Path(dataset.file.filename).parent
        for source in dataset.virtual_sources():
            if not (folder / source.file_name).is_file():
                raise FormatError(f"{name} is a link to a file that is gone", where=where,
                                  found=source.file_name)  # fmt: skip
    if dataset.nbytes > _MOST_COMPRESSED * Path(dataset.file.filename).stat().st_size + 1_000_000:
        raise FormatError(f"{name} is larger than its file can hold", where=where,
                          found=f"shape {dataset.shape}")  # fmt: skip
    start, stop = rows or (0, dataset.shape[0] if dataset.shape else 0)
    return np.asarray(dataset[start:stop] if dataset.shape else dataset[()])


def linked(group: h5py.Group, name: str, source: h5py.VirtualSource, rows: slice) -> None:
    """Add a virtual dataset that shows `rows` of `source`."""
    part = source[rows]
    layout = h5py.VirtualLayout(part.shape, source.dtype)
    layout[:] = part
    group.create_virtual_dataset(name, layout)
