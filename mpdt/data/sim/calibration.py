"""Calibration: the mixing rate of `medium` per task of a script, as data with its evidence.

Those of Meta-World are shipped in `weights/metaworld.json`, one line per (task, horizon).
`calibrate.py` measures, into a file of the working folder; a rate that is there wins over the
shipped one.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import msgspec
import numpy as np

from mpdt.data.sim.book import read_book, write_book
from mpdt.disk import check_replaceable, holding
from mpdt.draw.table import markdown_table

FORMAT = "mpdt-calibration/1"
SHIPPED = "metaworld"
"""Whose mixing rates mpdt comes with."""
LOCAL_FILE = f"{SHIPPED}.calibration.json"

Place = tuple[str, int]
"""What a calibration is for: task name and horizon."""


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
        curve: every coarse measurement, from the random side to the script's.
        seed: root seed; episodes use quality CALIBRATION, block 0, rows 0, 1, ... of the family, of
            Meta-World mt50.
        versions: packages the numbers were measured with.
        policy: hash (hex) of the script that was mixed; "" in files older than this field.
        env: simulator options.
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
    policy: str = ""
    env: dict[str, float | bool] = {}

    def level_at(self, rate: float) -> float:
        """Level of any rate, linear between the measured ones."""
        rest = [point for point in self.curve if point.rate != self.rate]
        points = (self.random, *rest, self.medium, self.expert)
        levels = {point.rate: point.level for point in sorted(points, key=lambda p: p.rate)}
        return float(np.interp(rate, list(levels), list(levels.values())))


def load_calibrations(folder: Path | None = None, rates: str = SHIPPED) -> dict[Place, Calibration]:
    """Calibrations by (task, horizon): those of `local_path(folder)`, then the shipped ones.

    A local one wins, so that a user can repair a rate; `Ladder.notice` tells of it, and the
    hash of the policy that acted is part of every episode's digest.

    Args:
        rates: of which families, see `Family.rates`.
    Raises: DataError for a file that is not a calibration; StorageError.
    """
    shipped = Path(str(resources.files("mpdt.data.weights"))) / f"{SHIPPED}.json"
    return (read_calibrations(shipped) if rates == SHIPPED else {}) | load_local(folder, rates)


def load_local(folder: Path | None = None, rates: str = SHIPPED) -> dict[Place, Calibration]:
    """The calibrations of `local_path(folder)` alone. Raises: as `load_calibrations`."""
    path = local_path(folder, rates)
    return read_calibrations(path) if os.path.lexists(path) else {}


def local_path(folder: Path | None = None, rates: str = SHIPPED) -> Path:
    """Where a calibration is written, and looked for, in `folder` (default: here)."""
    return (folder or Path()) / f"{rates}.calibration.json"


def read_calibrations(path: Path) -> dict[Place, Calibration]:
    """The calibrations of one file. Raises: as `load_calibrations`."""
    entries = read_book(path, Calibration, FORMAT, "calibration file")
    return {(entry.task, entry.horizon): entry for entry in entries}


def check_target(path: Path) -> None:
    """Whether `save_calibrations` could add to `path` now: asked before hours of measuring.

    Raises: as `save_calibrations`.
    """
    check_replaceable(path)
    if path.exists():
        read_calibrations(path)


def save_calibrations(path: Path, entries: Sequence[Calibration], rule: str) -> None:
    """Write entries sorted by (task, horizon), one per line; those already there are kept.

    An entry for the same task and horizon is replaced. `rule` tells readers how the rates
    were found. Atomic.

    Raises: DataError if something else is in `path`; StorageError where the disk refuses.
    """
    with holding(path, amends=True):
        merged = read_calibrations(path) if path.exists() else {}
        merged |= {(entry.task, entry.horizon): entry for entry in entries}
        write_book(path, (merged[key] for key in sorted(merged)), FORMAT, rule)


def table(entries: Sequence[Calibration]) -> str:
    """Markdown table of calibrations by task and horizon: rate, level, returns, success.

    r / m / e = random / medium / expert. Written into docs/calibration.md.
    """
    rows = []
    for entry in sorted(entries, key=lambda entry: (entry.task, entry.horizon)):
        three = (entry.random, entry.medium, entry.expert)
        rows.append((
            entry.task,
            f"{entry.horizon}",
            f"{entry.rate:.3f}",
            f"{entry.level:.2f} ± {entry.medium.level_error:.2f}",
            " / ".join(f"{found.mean_return:.0f}" for found in three),
            " / ".join(f"{found.success:.2f}" for found in three),
            " / ".join(f"{found.episodes}" for found in three),
            "yes" if entry.monotone else "no",
        ))  # fmt: skip
    columns = ("task", "steps", "rate", "level", "return r / m / e", "success r / m / e",
               "episodes r / m / e", "monotone")  # fmt: skip
    return markdown_table(columns, rows) + "\n"
