"""format: a complete mpdt/1 file whose arrays lie as a reader maps them."""

from __future__ import annotations

from pathlib import Path

from mpdt.data.store import layout
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.opening import opened
from mpdt.data.store.origin import damaged_hint
from mpdt.data.store.reader import read_file
from mpdt.data.verify.finding import Fault, Finding, Outcome, judge
from mpdt.errors import FormatError, quoted

ID = "format"


def open_unchecked(path: Path) -> tuple[Dataset | None, Finding]:
    """The file as far as its format allows, and what `format` says of it.

    Raises: MissingFileError, StorageError: there is nothing to judge then.
    """
    try:
        faults = _misaligned(path)
        # A copy of its arrays could fill the memory: such a file is not read.
        dataset = None if faults else read_file(path, checked=False)
    except FormatError as error:
        what = f"{error.what}; expected {error.expected}" if error.expected else error.what
        text = f"{what}; found {error.found}" if error.found else what
        return None, Finding(ID, Outcome.FAIL, text, hint=error.hint or damaged_hint(path))
    hint = f"mpdt-data import {quoted(path)} brings foreign files into this format"
    return dataset, judge(ID, faults, f"{layout.FORMAT}, complete, contiguous", hint)


def _misaligned(path: Path) -> list[Fault]:
    """Arrays that a reader could not map; what else is wrong with one is told by opening."""
    with opened(path) as file:
        return [
            Fault(f"/{array.path} is misaligned: offset {array.offset} is no multiple of "
                  f"{layout.ALIGNMENT_BYTES}")
            for array in file.tree.arrays.values()
            if _is_mapped(array.path) and (array.offset or 0) % layout.ALIGNMENT_BYTES
        ]  # fmt: skip


def _is_mapped(path: str) -> bool:
    return "steps/" in path or path.rpartition("/")[2].startswith("sim_")
