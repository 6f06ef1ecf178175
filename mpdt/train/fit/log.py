"""metrics.jsonl: one line of JSON per report of a run, cut back when a checkpoint is resumed."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from mpdt.disk import disk, sync
from mpdt.errors import FormatError, StorageError
from mpdt.reading import decode_json, open_plain


class Line(msgspec.Struct, frozen=True):
    """What is looked at of a line; other keys may stand there too."""

    phase: str
    step: int = 0
    action_loss: float = 0.0
    action_error: float = 0.0
    start: str = ""
    losses: list[float] = []
    task: str = ""
    weights: dict[str, float] | list[Any] = []


# What a line of these phases has to have.
_NEEDED = {"adapt": ("step", "start", "losses"), "infer": ("task", "weights"),
           "validation": ("step", "action_error")}  # fmt: skip


# Runs once told the mean square of a prompt without tokens, and JSON has no word for that.
_NO_NUMBER = b": null"
_MEND = "mend the line, or train again with --restart"


class MetricsLog:
    """Append-only lines of JSON. `size_bytes` goes into checkpoints, `cut` undoes what came after.

    So a resumed run has exactly the lines of an unbroken one.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def size_bytes(self) -> int:
        return self.path.stat().st_size if self.path.exists() else 0

    def append(self, record: Mapping[str, Any]) -> None:
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(record) + "\n")
        except OSError as error:
            raise StorageError(f"cannot write: {error.strerror}", where=str(self.path)) from error

    def sync(self) -> None:
        """Onto the disk itself, before a checkpoint says how long it is. Raises: StorageError."""
        if self.path.exists():
            with disk(self.path):
                sync(self.path)

    def check(self, size_bytes: int) -> None:
        """Raises: FormatError unless a line ends after `size_bytes`; StorageError."""
        there = self.size_bytes
        if there >= size_bytes and self._ends_line(size_bytes):
            return
        raise FormatError("not the log that the weights beside it were written with",
                          where=str(self.path), expected=f"a line that ends at byte {size_bytes:,}",
                          found=f"{there:,} bytes" if there < size_bytes else "none ends there",
                          hint="put the log of this run back, or train again with --restart"
                          )  # fmt: skip

    def _ends_line(self, size_bytes: int) -> bool:
        if not size_bytes:
            return True
        with disk(self.path), self.path.open("rb") as file:
            file.seek(size_bytes - 1)
            return file.read(1) == b"\n"

    def cut(self, size_bytes: int) -> None:
        """Forget every line behind the first `size_bytes`. Raises: as `check`."""
        self.check(size_bytes)
        if self.size_bytes > size_bytes:
            with disk(self.path):
                os.truncate(self.path, size_bytes)
            self.sync()

    def put(self, size_bytes: int, records: Sequence[Mapping[str, Any]]) -> None:
        """These after the first `size_bytes`, instead of what was there. Raises: as `check`."""
        self.cut(size_bytes)
        for record in records:
            self.append(record)
        self.sync()

    def records(self) -> list[dict[str, Any]]:
        """All lines; a last one that a kill cut off is left out.

        Raises: FormatError with the number of a line that is none of ours; StorageError.
        """
        if not self.path.exists():
            return []
        with open_plain(self.path) as file:
            lines = file.readlines()
        if lines and not lines[-1].endswith(b"\n"):
            del lines[-1]
        records = [self._record(line, number) for number, line in enumerate(lines, 1)]
        self._check_tasks(records)
        return records

    def _check_tasks(self, records: Sequence[Mapping[str, Any]]) -> None:
        """Raises: FormatError where lines of one start tell of different numbers of tasks."""
        counts: dict[str, int] = {}
        for number, record in enumerate(records, 1):
            if record["phase"] != "adapt":
                continue
            losses = record["losses"]
            if (known := counts.setdefault(record["start"], len(losses))) != len(losses):
                raise FormatError("another number of tasks than before",
                                  where=f"{self.path}, line {number}", expected=str(known),
                                  found=str(len(losses)), hint=_MEND)  # fmt: skip

    def _record(self, line: bytes, number: int) -> dict[str, Any]:
        try:
            record: dict[str, Any] = decode_json(line.replace(b": NaN", _NO_NUMBER))
            known = msgspec.convert(record, Line)
            needed = ("phase", "step") if "action_loss" in record else _NEEDED.get(known.phase, ())
            missing = [key for key in needed if key not in record]
            if missing:
                raise ValueError(f"no `{missing[0]}` in a line of phase `{known.phase}`")
        except ValueError as error:
            raise FormatError("not a line of metrics", where=f"{self.path}, line {number}",
                              found=str(error),
                              hint=_MEND) from error  # fmt: skip
        return record
