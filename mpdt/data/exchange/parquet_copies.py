"""Tables of a Parquet export that repeat its manifest, for readers without mpdt.

An import believes the manifest. A table beside it that says something else has been damaged or
edited by someone who will look for the change, so it is refused.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from mpdt.data.exchange.manifest import AGAIN
from mpdt.data.reference import REFERENCE_POLICIES
from mpdt.data.store.sources import FileHeader
from mpdt.errors import FormatError
from mpdt.reading import refuse_other

_MOST_BYTES = 100_000_000
"""Of a table, unpacked; that of fifty tasks has some ten thousand."""


def tasks_table(header: FileHeader) -> Any:
    """What is told of every task, one row each."""
    columns: dict[str, list[Any]] = {
        "name": [task.name for task in header.tasks],
        "index": [task.index for task in header.tasks],
        "role": [task.role for task in header.tasks],
        "env": [json.dumps(task.env, sort_keys=True) for task in header.tasks],
    }
    for policy in REFERENCE_POLICIES:
        references = [task.references[policy] for task in header.tasks]
        columns[f"ref_{policy}"] = [reference.mean for reference in references]
        columns[f"ref_{policy}_error"] = [reference.error for reference in references]
        columns[f"ref_{policy}_episodes"] = [reference.episodes for reference in references]
    return pa.table(columns)


def policies_table(header: FileHeader) -> Any:
    """What is told of every policy, one row each; `task` is a row of tasks.parquet."""
    rows = {task.index: row for row, task in enumerate(header.tasks)}
    columns: dict[str, list[Any]] = {
        "hash": [policy.hash for policy in header.policies],
        "task": [rows[policy.task] for policy in header.policies],
    }
    for name in ("rung", "level", "train_step", "mix_rate", "name"):
        columns[name] = [getattr(policy, name) for policy in header.policies]
    return pa.table(columns)


_COPIES = {"tasks.parquet": tasks_table, "policies.parquet": policies_table}


def copies_in(folder: Path) -> Iterator[Path]:
    """Those of the tables that are there: a tree without them has lost nothing."""
    for name in _COPIES:
        if (path := folder / name).exists():
            yield path


def check_copy(path: Path, header: FileHeader) -> None:
    """The columns that we write and that are there, row by row; others are somebody's own.

    Raises: FormatError where it says something else than the manifest; pyarrow.ArrowException.
    """
    refuse_other(path, "a Parquet file", "a Parquet file")
    ours = _COPIES[path.name](header)
    with pq.ParquetFile(path) as file:
        names = [name for name in ours.column_names if name in file.schema_arrow.names]
        sizes = [file.metadata.row_group(i).total_byte_size for i in range(file.num_row_groups)]
        if sum(sizes) > _MOST_BYTES:
            raise FormatError("larger than what it repeats can be", where=str(path),
                              found=f"{sum(sizes):,} bytes", hint=AGAIN)  # fmt: skip
        is_table = file.metadata.num_rows == len(ours)
        found = file.read(columns=names, use_threads=False) if is_table else None
    for name in names:
        if found is None or _cells(found, name) != _cells(ours, name):
            raise FormatError("not what the manifest of the export says", where=f"{path}: {name}",
                              hint=AGAIN)  # fmt: skip


def _cells(table: Any, name: str) -> str:
    return repr(table.column(name).to_pylist())  # as text NaN is NaN
