"""format: a complete mpdt/1 file whose arrays lie as a reader maps them."""

from __future__ import annotations

from pathlib import Path

import h5py

from mpdt.data.store import layout
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.opening import opened
from mpdt.data.store.origin import damaged_hint
from mpdt.data.store.reader import read_file
from mpdt.data.verify.finding import Fault, Finding, Outcome, judge
from mpdt.errors import FormatError

ID = "format"


def open_unchecked(path: Path) -> tuple[Dataset | None, Finding]:
    """The file as far as its format allows, and what `format` says of it.

    Raises: MissingFileError, StorageError: there is nothing to judge then.
    """
    try:
        faults = _layout_faults(path)
        # A copy of a foreign file's arrays could fill the memory: such a file is not opened.
        dataset = None if faults else read_file(path, checked=False)
    except FormatError as error:
        what = f"{error.what}; expected {error.expected}" if error.expected else error.what
        text = f"{what}; found {error.found}" if error.found else what
        return None, Finding(ID, Outcome.FAIL, text, hint=error.hint or damaged_hint(path))
    hint = f"mpdt-data import {path} brings foreign files into this format"
    return dataset, judge(ID, faults, f"{layout.FORMAT}, complete, contiguous", hint)


def _layout_faults(path: Path) -> list[Fault]:
    """Datasets that a reader could not map. What is missing is told by the reader."""
    with opened(path) as (file, _):
        groups = {f"/{name}": columns for name, columns in layout.GROUPS.items()}
        for name in file.get("tta", {}):
            for key, columns in layout.TTA_GROUPS.items():
                groups[f"/tta/{name}/{key}".rstrip("/")] = columns
        faults = []
        for group, columns in groups.items():
            for column in columns:
                found = file.get(f"{group}/{column.path}")
                if isinstance(found, h5py.Dataset) and (what := _dataset_fault(found)):
                    faults.append(Fault(f"{found.name} {what}"))
    return faults


def _dataset_fault(dataset: h5py.Dataset) -> str:
    """What keeps a reader from mapping this dataset, or nothing."""
    if dataset.chunks is not None or dataset.is_virtual or dataset.external:
        return "is not contiguous"
    offset = dataset.id.get_offset()
    if offset is None:  # empty, or so small that it lies in the header
        return ""
    is_steps = "/steps" in dataset.name or dataset.name.rpartition("/")[2].startswith("sim_")
    if is_steps and offset % layout.ALIGNMENT_BYTES:
        return f"is misaligned: offset {offset} is no multiple of {layout.ALIGNMENT_BYTES}"
    return ""
