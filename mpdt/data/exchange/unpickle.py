"""Read a pickle as data: lists, dicts, numbers, text and numpy arrays, and nothing that runs.

`pickletools` names the operations of a pickle without performing any. The machine below
performs those that build plain values and arrays. A global is a word it compares with six
known ones; it imports nothing and calls nothing that the file names, so that anything else is
an error.

    global in the file                                 stands for
    numpy(.core|._core).multiarray._reconstruct        an array to be filled by BUILD
    numpy(.core|._core).multiarray.scalar              a number with a dtype
    numpy(.core|._core).numeric._frombuffer            an array (protocol 5)
    numpy.ndarray, numpy.dtype                         arguments of these
    _codecs.encode                                     bytes as text (protocol 2 and older)

Memory follows the size of the file: arrays are views of its bytes.
"""

from __future__ import annotations

import pickletools
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from mpdt.data.exchange.pickle_machine import Machine, RefusedError, kind_of
from mpdt.errors import FormatError
from mpdt.reading import read_plain, refuse_other

MAX_BYTES = 1 << 30
MAX_OPERATIONS = 5_000_000
"""A thousand episodes of five arrays have about 125,000 operations."""

# What numpy writes before the pickle of a list-like object array; anything else is another file.
_NPY_OF_OBJECTS = re.compile(
    rb"\x93NUMPY\x01\x00..\{'descr': '\|O', 'fortran_order': (?:True|False), "
    rb"'shape': \(\d+,\), \} *\n",
    re.DOTALL,
)
_HINT = "only lists, dicts, numbers, text and numpy arrays are read; nothing in the file was run"


def load_pickle(path: Path) -> Any:
    """The value in a pickle file, of any protocol.

    Raises: MissingFileError; StorageError; FormatError for a global or operation that is not
        allowed (it is named), for damage, and for more than `MAX_BYTES`.
    """
    refuse_other(path, "a pickle", "a pickle", "text")  # protocol 0 is text
    return load_bytes(_read(path), str(path))


def load_object_array(path: Path) -> list[Any]:
    """The items of a one-dimensional object array in a `.npy` file, whose content is a pickle.

    Raises: as `load_pickle`; FormatError for another kind of array.
    """
    refuse_other(path, "an .npy file of dicts", "an array of numpy (.npy)")
    data, where = _read(path), str(path)
    header = _NPY_OF_OBJECTS.match(data)
    if header is None:
        found = data[10:60].decode("latin1") if data.startswith(b"\x93NUMPY") else "no .npy header"
        raise FormatError("not an .npy file of dicts", where=where, found=found)
    array = load_bytes(data[header.end() :], where)
    if not isinstance(array, np.ndarray) or array.dtype.kind != "O" or array.ndim != 1:
        raise FormatError("not an .npy file of dicts", where=where, found=kind_of(array))
    return list(array)


def load_bytes(data: bytes, where: str) -> Any:
    """The value of one pickle in memory. Raises: FormatError."""
    machine, position = Machine(len(data)), 0
    try:
        for count, (opcode, argument, place) in enumerate(pickletools.genops(data)):
            position = place or 0
            if count >= MAX_OPERATIONS:
                raise RefusedError(f"more than {MAX_OPERATIONS:,} operations")
            machine.perform(opcode.name, argument)
        (value,) = machine.stack
    except RefusedError as refused:
        raise FormatError(f"{refused} is not allowed in a pickle", where=where,
                          found=f"at byte {position}", hint=_HINT) from refused  # fmt: skip
    except (ValueError, TypeError, KeyError, IndexError, OverflowError, struct.error) as error:
        raise FormatError("damaged, or not a pickle", where=where,
                          found=f"{str(error)[:120]} at byte {position}") from error  # fmt: skip
    return value


def _read(path: Path) -> bytes:
    return read_plain(path, MAX_BYTES)
