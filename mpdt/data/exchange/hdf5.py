"""HDF5 files of others: opened with one error for all damage, and everything inside themselves.

HDF5 can point elsewhere: soft and external links, external storage and virtual datasets show any
file of the disk, and one whose source is gone reads as zeros, without an error. None of them is
followed, wherever in the file it is.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5d, h5g, h5l, h5o, h5z
from numpy.typing import NDArray

from mpdt.errors import FormatError, MpdtError
from mpdt.reading import refuse_other

_MOST_COMPRESSED = 100
"""Numbers per stored one at most. Empty chunks take no place, so a shape may say anything."""
_FILTERS = {h5z.FILTER_DEFLATE, h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32, h5z.FILTER_SZIP,
            h5z.FILTER_NBIT, h5z.FILTER_SCALEOFFSET, h5z.FILTER_LZF}  # fmt: skip
"""Those that come with HDF5; another one would be code that is loaded because a file says so."""
_LINKED = "copy what it shows into the file (h5repack, or an export without --link)"
# What h5py and numpy raise about metadata that makes no sense.
_DAMAGE = (
    OSError, RuntimeError, ValueError, TypeError, KeyError, IndexError, AttributeError,
    OverflowError, MemoryError, NotImplementedError,
)  # fmt: skip


@contextmanager
def created(path: Path) -> Iterator[h5py.File]:
    """A new file for writing.

    Raises: OSError where the disk refuses, once HDF5 is done: it cannot close a file whose writes
        fail, complains for every object in it, and takes the process down in the end.
    """
    with path.open("x+b", buffering=0) as stream:
        kept = _Kept(stream)
        try:
            with h5py.File(kept, "w") as file:
                yield file
        except BaseException:
            kept.abandon()
            raise
        if kept.refusal is not None:
            raise kept.refusal


class _Kept:
    """The bytes of a file being written; the first refusal of the disk is kept, not raised."""

    def __init__(self, stream: io.FileIO) -> None:
        self._stream: io.FileIO | io.BytesIO = stream
        self.refusal: OSError | None = None

    def abandon(self) -> None:
        """A signal may come before HDF5 has closed the file: what it does later goes nowhere."""
        self.refusal, self._stream = self.refusal or OSError("abandoned"), io.BytesIO()

    def write(self, content: bytes) -> int:
        if self.refusal is None:
            try:
                self._put(memoryview(content))
            except OSError as error:
                self.refusal = error
        return len(content)

    def _put(self, view: memoryview) -> None:
        while view:
            view = view[self._stream.write(view) :]

    def truncate(self, size: int) -> int:
        if self.refusal is None:
            try:
                return self._stream.truncate(size)
            except OSError as error:
                self.refusal = error
        return size

    def readinto(self, buffer: bytearray) -> int:
        memoryview(buffer)[:] = bytes(len(buffer))  # behind a refusal, or the end, are zeros
        return self._stream.readinto(buffer) or 0

    def read(self, size: int = -1) -> bytes:
        return self._stream.read(size) or b""

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._stream.seek(offset, whence)

    def tell(self) -> int:
        return self._stream.tell()

    def flush(self) -> None:
        """Nothing is held back here."""


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """A foreign file for reading, in which no link leads anywhere else.

    Raises: MissingFileError; StorageError; FormatError for whatever cannot be read in it, and for
        links of any kind.
    """
    where = str(path)
    refuse_other(path, "an HDF5 file", "an HDF5 file")
    try:
        with h5py.File(path, "r") as file:
            root = h5g.open(file.id, b"/")
            _refuse_links(root, "", {int(h5o.get_info(root).addr)}, where)
            yield file
    except MpdtError:
        raise
    except _DAMAGE as error:
        raise FormatError("damaged, or not an HDF5 file", where=where,
                          found=f"{type(error).__name__}: {error}"[:160]) from error  # fmt: skip


def _refuse_links(group: h5g.GroupID, above: str, seen: set[int], where: str) -> None:
    """Raises: FormatError for the first thing that is not linked once, by a name of its own."""
    found: list[tuple[bytes, int, Any]] = []
    group.links.iterate(lambda name, info: found.append((name, info.type, info.u)), info=True)
    for name, kind, at in found:
        path = f"{above}/{name.decode('utf-8', 'replace')}"
        if kind != h5l.TYPE_HARD:
            if kind != h5l.TYPE_EXTERNAL:
                raise FormatError(f"{path} is a link", where=where, hint=_LINKED)
            target = bytes(group.links.get_val(name)[0]).decode("utf-8", "replace")
            raise FormatError(f"{path} is in another file", where=where, found=target,
                              hint=_LINKED)  # fmt: skip
        if int(at) in seen:
            raise FormatError(f"{path} is a second name for something", where=where, hint=_LINKED)
        seen.add(int(at))
        if h5o.get_info(group, name).type == h5o.TYPE_GROUP:
            _refuse_links(h5g.open(group, name), path, seen, where)


def member(group: h5py.Group, name: str, where: str) -> Any:
    """What is called `name` in the file. Raises: FormatError where it is missing."""
    for part in name.split("/"):
        if not isinstance(group, h5py.Group) or group.get(part, getlink=True) is None:
            raise FormatError(f"no {name}", where=where)
        group = group[part]
    return group


def array(
    group: h5py.Group, name: str, where: str, rows: tuple[int, int] | None = None
) -> NDArray[Any]:
    """A dataset of plain numbers, or `rows` of it.

    Raises: FormatError for a group, for text or objects, for numbers kept in other files or behind
        a filter that is not HDF5's own, and for a size that no file has.
    """
    dataset = member(group, name, where)
    if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in "fiub":
        found = f"type {dataset.dtype}" if isinstance(dataset, h5py.Dataset) else "a group"
        raise FormatError(f"{name} is no array of numbers", where=where, found=found,
                          hint="observations of several parts are not supported"
                               if isinstance(dataset, h5py.Group) else "")  # fmt: skip
    plan = dataset.id.get_create_plist()
    if plan.get_layout() == h5d.VIRTUAL or plan.get_external_count():
        raise FormatError(f"{name} is in another file", where=where, hint=_LINKED)
    filters = [plan.get_filter(number)[0] for number in range(plan.get_nfilters())]
    if unknown := [number for number in filters if number not in _FILTERS]:
        raise FormatError(f"{name} is behind a filter that is not HDF5's own", where=where,
                          found=f"filter {unknown[0]}", hint="h5repack -f GZIP=1")  # fmt: skip
    size = prod(dataset.shape) * dataset.dtype.itemsize
    stored = dataset.id.get_storage_size() if size else 0
    if size > _MOST_COMPRESSED * stored + 1_000_000 or (size and not stored):
        raise FormatError(f"{name} is larger than its file can hold", where=where,
                          expected=f"{size:,} bytes of shape {dataset.shape}",
                          found=f"{stored:,} stored")  # fmt: skip
    start, stop = rows or (0, dataset.shape[0] if dataset.shape else 0)
    return np.asarray(dataset[start:stop] if dataset.shape else dataset[()])


def linked(group: h5py.Group, name: str, source: h5py.VirtualSource, rows: slice) -> None:
    """Add a virtual dataset that shows `rows` of `source`."""
    part = source[rows]
    layout = h5py.VirtualLayout(part.shape, source.dtype)
    layout[:] = part
    group.create_virtual_dataset(name, layout)
