"""Calibration: the mixing rate of `medium` per Meta-World task, as data with its evidence.

Shipped in `weights/metaworld.json`, one line per (task, horizon). `calibrate.py` measures.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import msgspec
import numpy as np

from mpdt.data.spec.entry import canonical_json
from mpdt.errors import DataError, MissingFileError

FORMAT = "mpdt-calibration/1"
LOCAL_FILE = "metaworld.calibration.json"


class Measurement(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Mean return and success rate of one mixing rate, and its level with standard error."""

    rate: float
    episodes: int
    mean_return: float
    success: float
    level: float
    level_error: float


class Calibration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The mixing rate of `medium` for one task at one horizon, and what it rests on.

    Args:
        level: normalised return at `rate`, 0 = uniform actions, 1 = the script alone.
        random, medium, expert: measured at rate 1, `rate` and 0.
        monotone: the curve neither turns nor rises above the script, but for noise.
        curve: every coarse measurement, from rate 0.95 down to 0.05.
        seed: root seed; episodes use family mt50, quality CALIBRATION, block 0, rows 0, 1, ...
        versions: packages the numbers were measured with.
    """

    task: str
    horizon: int
    rate: float
    level: float
    random: Measurement
    medium: Measurement
    expert: Measurement
    monotone: bool
    curve: tuple[Measurement, ...]
    seed: int
    versions: dict[str, str]

    def level_at(self, rate: float) -> float:
        """Level of any rate, linear between the measured ones."""
        rest = [point for point in self.curve if point.rate != self.rate]
        points = (self.random, *rest, self.medium, self.expert)
        levels = {point.rate: point.level for point in sorted(points, key=lambda p: p.rate)}
        return float(np.interp(rate, list(levels), list(levels.values())))


class _Book(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    format: str
    rule: str
    entries: tuple[Calibration, ...]


def load_calibrations(folder: Path | None = None) -> dict[tuple[str, int], Calibration]:
    """Calibrations by (task, horizon): the shipped ones, then those of `folder`/LOCAL_FILE.

    A shipped one always wins, so no file lying about can change a published dataset.

    Raises: DataError for a file that is not a calibration.
    """
    shipped = Path(str(resources.files("mpdt.data.weights"))) / "metaworld.json"
    found: dict[tuple[str, int], Calibration] = {}
    for path in (shipped, (folder or Path()) / LOCAL_FILE):
        if path.is_file():
            for entry in _read(path):
                found.setdefault((entry.task, entry.horizon), entry)
    return found


def _read(path: Path) -> tuple[Calibration, ...]:
    try:
        book = msgspec.json.decode(path.read_bytes(), type=_Book)
    except msgspec.DecodeError as error:
        raise DataError("not a calibration file", where=str(path), found=str(error)) from error
    if book.format != FORMAT:
        raise DataError(
            "another calibration format", where=str(path), expected=FORMAT, found=book.format
        )
    return book.entries


def save_calibrations(path: Path, entries: Sequence[Calibration], rule: str) -> None:
    """Write entries sorted by (task, horizon), one per line; those already there are kept.

    An entry for the same task and horizon is replaced. `rule` tells readers how the rates
    were found. Atomic.
    """
    if not path.parent.is_dir():
        raise MissingFileError("no such folder", where=str(path.parent))
    merged = {(e.task, e.horizon): e for e in (*(_read(path) if path.is_file() else ()), *entries)}
    lines = ",\n".join(canonical_json(merged[key]).decode() for key in sorted(merged))
    head = f'{{"format":{json.dumps(FORMAT)},\n"rule":{json.dumps(rule)},\n"entries":[\n'
    partial = path.with_name(path.name + ".tmp")
    partial.write_text(f"{head}{lines}\n]}}\n")
    partial.replace(path)
