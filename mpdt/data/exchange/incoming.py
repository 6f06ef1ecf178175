"""Incoming: what any format gives to be written as a file, and the one way it is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mpdt.data.store.dataset import Dataset
from mpdt.data.store.sources import EpisodeSource, FileHeader
from mpdt.data.store.tables import Additions
from mpdt.data.store.writer import write_file
from mpdt.disk import holding
from mpdt.errors import DataError


@dataclass(frozen=True)
class Incoming:
    """A header and its episodes in canonical order, read while they are written.

    Args:
        promised: content hash that an export of ours carries; "" for foreign files.
        remarks: what the user should know, one line each.
    """

    header: FileHeader
    source: EpisodeSource
    promised: str = ""
    remarks: tuple[str, ...] = ()


def store(incoming: Incoming, target: Path, finish: Callable[[Dataset], Additions]) -> Dataset:
    """Write an import to `target` and open it.

    Args:
        finish: slices and statistics of the new file, as in `write_file`.
    Raises: DataError if something is at `target` already, or if the episodes are not those
        that were exported; BusyError; otherwise as `write_file` and the format's own reader.
    """

    def checked(dataset: Dataset) -> Additions:
        if incoming.promised and dataset.content_hash != incoming.promised:
            raise DataError("not the episodes that were exported", where=str(target),
                            expected=f"content {incoming.promised[:16]}",
                            found=dataset.content_hash[:16],
                            hint="something changed them; export or copy them again")  # fmt: skip
        return finish(dataset)

    with holding(target) as hold:
        if hold.found is not None:
            raise DataError("an import would replace another file", where=str(target),
                            hint="choose another name with -o, or move that file away first",
                            )  # fmt: skip
        return write_file(target, incoming.header, incoming.source, finish=checked)
