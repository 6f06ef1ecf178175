"""What a run has cost so far, over all processes that worked on it: `spent.json` in its folder."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from mpdt.disk import write_bytes
from mpdt.errors import MpdtError
from mpdt.reading import read_json
from mpdt.train.run.folder import RunFolder
from mpdt.train.run.results import read_results_file


class Spent:
    """Seconds of training; a kill loses those of the process that was killed.

    Args:
        folder: of the run, which this process has to itself.
    """

    def __init__(self, folder: RunFolder) -> None:
        self._path = folder.spent
        self.training_s = _read(folder)

    @contextmanager
    def training(self) -> Iterator[None]:
        """Count what happens inside, also where it is stopped."""
        began_s = time.monotonic()
        try:
            yield
        finally:
            self.training_s += time.monotonic() - began_s
            content = json.dumps({"training_s": round(self.training_s, 3)}) + "\n"
            write_bytes(self._path, content.encode())


def _read(folder: RunFolder) -> float:
    """Of earlier processes; of a run from before this was kept, what its results say."""
    found: Any = None
    with suppress(MpdtError):
        found = read_json(folder.spent).get("training_s")
    if _is_time(found):
        return float(found)
    # A judgement that came later trained nothing and said so.
    earlier = [folder.results, *folder.judged_ones()]
    return max(filter(_is_time, map(_told, earlier)), default=0.0)


def _told(path: Path) -> Any:
    try:
        seconds = read_results_file(path).get("seconds")
    except MpdtError:
        return None
    return seconds.get("training") if isinstance(seconds, dict) else None


def _is_time(value: Any) -> bool:
    return isinstance(value, int | float) and 0 <= value < math.inf
