"""Seal: one SHA-256 over all that no digest covers, so that any change of a file is found.

    /steps, /tta/*/steps       each episode's digest
    everything else            the seal: tables, slices, statistics, references, versions ...

Not an identity: adding a slice gives a new seal and the same content hash. A program that changes
a file has to seal it anew; whoever changed it without is found by `mpdt-data verify`.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mpdt.data.spec.entry import canonical_json
from mpdt.errors import FormatError

ATTRIBUTE = "seal"
_OUTSIDE = ("seal", "complete")  # attributes of the root
_DIGESTED = re.compile(r"(tta/[^/]+/)?steps/[^/]+")


def seal(file: h5py.File) -> None:
    """Write the seal, last of all but `complete`."""
    file.attrs[ATTRIBUTE] = seal_of(file)


def check_seal(file: h5py.File, where: Path) -> None:
    """Raises: FormatError if something in the file is not what its writer sealed."""
    if not _holds(file):
        raise FormatError("the seal is broken: something outside the episodes was changed",
                          where=str(where), hint="mpdt-data verify says what; collect it again "
                          "or take another copy")  # fmt: skip


def seal_holds(path: Path) -> bool:
    """Whether the file is what its writer sealed. False also for what cannot be read."""
    try:
        with h5py.File(path) as file:
            return _holds(file)
    except OSError:
        return False


def _holds(file: h5py.File) -> bool:
    try:
        return bool(file.attrs.get(ATTRIBUTE) == seal_of(file))
    except (OSError, RuntimeError, KeyError, ValueError, TypeError):  # HDF5's words for damage
        return False


def seal_of(file: h5py.File) -> str:
    """64 hex digits over names, types, shapes, values and attributes, in order of the names."""
    names: list[str] = []
    file.visit(names.append)
    whole = hashlib.sha256()
    for name in ["/", *sorted(names)]:
        item = file[name]
        whole.update(canonical_json([name, type(item).__name__, _attributes(item)]))
        if isinstance(item, h5py.Dataset):
            whole.update(canonical_json([str(item.dtype), list(item.shape)]))
            if not _DIGESTED.fullmatch(name):
                whole.update(_content(item[()]))
    return whole.hexdigest()


def _attributes(item: Any) -> list[list[str]]:
    # A fixed order: HDF5 lists attributes as they were made.
    return [
        [key, hashlib.sha256(_content(item.attrs[key])).hexdigest()]
        for key in sorted(item.attrs)
        if not (item.name == "/" and key in _OUTSIDE)
    ]


def _content(value: Any) -> bytes:
    array = np.asarray(value)
    if array.dtype.kind in "OSU":  # text; damaged text may not be UTF-8
        items = [item if isinstance(item, bytes) else str(item).encode("utf-8", "surrogateescape")
                 for item in array.reshape(-1)]  # fmt: skip
        return b"".join(len(item).to_bytes(8, "little") + item for item in items)
    return str(array.dtype).encode() + array.tobytes()
