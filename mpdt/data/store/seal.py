"""Seal: one SHA-256 over all that no digest covers, so that any change of a file is found.

    /steps, /tta/*/steps       each episode's digest
    everything else            the seal: tables, slices, statistics, references, versions, links

Whoever opens a file compares it before a table is believed.

Not an identity: adding a slice gives a new seal and the same content hash. A program that changes
a file has to seal it anew; whoever changed it without is found by `mpdt-data verify`.
"""

from __future__ import annotations

import hashlib
import re
from functools import lru_cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mpdt.data.spec.entry import canonical_json
from mpdt.data.store.tree import Tree
from mpdt.errors import FormatError

ATTRIBUTE = "seal"
_OUTSIDE = ("seal", "complete")  # attributes of the root
_DIGESTED = re.compile(r"(tta/[^/]+/)?steps/[^/]+")


def seal(file: h5py.File) -> None:
    """Write the seal, last of all but `complete`."""
    file.attrs[ATTRIBUTE] = seal_of(file)


def check_seal(tree: Tree, where: Path) -> None:
    """Raises: FormatError if something in the file is not what its writer sealed."""
    if not _holds(tree):
        raise FormatError("the seal is broken: something outside the episodes was changed",
                          where=str(where), hint="mpdt-data verify says what; take another "
                          "copy, or make it again")  # fmt: skip


def seal_holds(path: Path) -> bool:
    """Whether the file is what its writer sealed. False also for what cannot be read."""
    try:
        with h5py.File(path) as file:
            return _holds(Tree(file, str(path)))
    except OSError:
        return False


def _holds(tree: Tree) -> bool:
    try:
        return bool(tree.text("", ATTRIBUTE) == tree_seal(tree))
    except (OSError, RuntimeError, KeyError, ValueError, TypeError):  # HDF5's words for damage
        return False


def seal_of(file: h5py.File) -> str:
    """64 hex digits over names, types, shapes, values and attributes, in order of the names."""
    return tree_seal(Tree(file, file.filename))


def tree_seal(tree: Tree) -> str:
    """`seal_of` a file whose tree is known already.

    What is no group or array linked once counts by its name, kind and target; files of ours have
    nothing of the sort, and opening refuses it.
    """
    whole = hashlib.sha256()
    for path in sorted([*tree.groups, *tree.arrays, *tree.odd]):
        name = path or "/"
        if path in tree.odd:
            whole.update(canonical_json([name, *tree.odd[path]]))
            continue
        array = tree.arrays.get(path)
        kind = "Group" if array is None else "Dataset"
        whole.update(canonical_json([name, kind, _attributes(tree, path)]))
        if array is not None:
            whole.update(canonical_json([_dtype_name(array.dtype), list(array.shape)]))
            if not _DIGESTED.fullmatch(path):
                for piece in _content(array.values):
                    whole.update(piece)
    return whole.hexdigest()


_dtype_name = lru_cache(maxsize=64)(str)  # numpy takes its time


def _attributes(tree: Tree, path: str) -> list[list[str]]:
    # A fixed order: HDF5 lists attributes as they were made.
    return [
        [key, hashlib.sha256(b"".join(_content(value))).hexdigest()]
        for key, value in tree.attributes(path).items()
        if not (not path and key in _OUTSIDE)
    ]


def _content(value: Any) -> list[bytes | memoryview]:
    """In pieces: a column of a million episodes is not copied to be put behind its type."""
    array = np.asarray(value)
    if array.dtype.kind in "OSU":  # text; damaged text may not be UTF-8
        items = [item if isinstance(item, bytes) else str(item).encode("utf-8", "surrogateescape")
                 for item in array.reshape(-1)]  # fmt: skip
        return [b"".join(len(item).to_bytes(8, "little") + item for item in items)]
    flat = np.ascontiguousarray(array).reshape(-1)
    return [str(array.dtype).encode(), flat.view(np.uint8).data]
