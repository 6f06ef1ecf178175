"""metrics.jsonl: one line of JSON per report of a run, cut back when a checkpoint is resumed."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mpdt.errors import StorageError


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

    def cut(self, size_bytes: int) -> None:
        """Forget every line behind the first `size_bytes`."""
        if self.size_bytes > size_bytes:
            os.truncate(self.path, size_bytes)

    def records(self) -> list[dict[str, Any]]:
        if not self.path.exists():
            return []
        return [json.loads(line) for line in self.path.read_text(encoding="utf-8").splitlines()]
