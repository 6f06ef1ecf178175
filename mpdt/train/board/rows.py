"""Rows of the leaderboard, and the CSV file that holds them.

results.json, a study's cell, `evaluate --policy --json`  ──>  Row per method and protocol
leaderboard.csv                                                 one line per row

family, protocol, method, seed     what a row is of; a board has each once
return ... success                 mean over the tasks; `normalised` is its level
iqm, low, high, seeds              of all tasks and all rows that differ in the seed alone; runs
                                   that differ in the seed of trials alone are averaged first
levels                             `task=level` of every task: whatever is made of a board is
                                   made of these, so the file is enough
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mpdt.errors import FormatError
from mpdt.reading import read_plain
from mpdt.train.evaluate.aggregate import iqm, seed_means, stratified_interval
from mpdt.train.evaluate.score import MEAN, REFERENCES, Score
from mpdt.train.study.once import pooled
from mpdt.train.study.protocols import protocol_of
from mpdt.train.study.summary import told_seeds

TRAINED, REFERENCE, OUTSIDE = "training tasks", "reference", "said by nobody"
COLUMNS = ("family", "protocol", "method", "seed", "return", "success", "normalised", "iqm", "low",
           "high", "seeds", "reads", "episodes", "horizon", "data", "content_hash", "code",
           "command", "levels")  # fmt: skip
Key = tuple[str, str, str, str]


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One method with one seed in one protocol; numbers as the file has them, four decimals."""

    family: str
    protocol: str
    method: str
    seed: str
    """Of training; empty where nobody said one."""
    mean: float
    success: float | None
    normalised: float
    reads: str
    episodes: int
    horizon: int
    data: str
    """Name and version, and the slice that was trained on."""
    content_hash: str
    code: str
    command: str
    levels: tuple[tuple[str, float], ...]

    @property
    def key(self) -> Key:
        return self.family, self.protocol, self.method, self.seed

    @property
    def group(self) -> tuple[str, ...]:
        """What rows have in common that differ in their seed, or that of their trials, alone."""
        tasks = tuple(task for task, _ in self.levels)
        method = pooled(self.method)
        return (self.family, self.protocol, method, self.data, str(self.horizon), *tasks)


class Standing(msgspec.Struct, frozen=True, kw_only=True):
    """One method over all its seeds."""

    rows: tuple[Row, ...]
    iqm: float
    low: float
    high: float
    """95 % interval of the IQM; nan for one seed, which knows nothing of others."""

    @property
    def method(self) -> str:
        """Without the seed of trials, which its rows may differ in."""
        return pooled(self.rows[0].method)

    @property
    def mean(self) -> float:
        return float(self._of_seeds("mean").mean())

    @property
    def normalised(self) -> float:
        return float(self._of_seeds("normalised").mean())

    @property
    def success(self) -> float | None:
        known = [(row.seed, row.success) for row in self.rows if row.success is not None]
        return float(seed_means(known).mean()) if known else None

    @property
    def num_seeds(self) -> int:
        return len({row.seed for row in self.rows})

    @property
    def seeds(self) -> str:
        return told_seeds(self.num_seeds, len(self.rows))

    @property
    def levels(self) -> NDArray[np.float64]:
        return _levels(self.rows)

    def _of_seeds(self, name: str) -> NDArray[np.float64]:
        return seed_means((row.seed, getattr(row, name)) for row in self.rows)


def _levels(rows: Sequence[Row]) -> NDArray[np.float64]:
    """(R, N) normalised returns of R training seeds."""
    return seed_means((row.seed, [value for _, value in row.levels]) for row in rows)


def rows_of(results: Mapping[str, Any], scores: Sequence[Score], family: str,
            command: str, label: str | None = None) -> list[Row]:  # fmt: skip
    """The rows of one result.

    Args:
        results: the header, as `results.json` has it.
        label: instead of the method's own name in front of its rows.
    """
    data, config = results["data"], results.get("config", {})
    own = str(config.get("method", results.get("name", "")))
    said = {
        "family": family,
        "seed": str(config["seed"]) if "seed" in config else "",
        "horizon": int(data["horizon"]),
        "data": f"{data['name']} {data['version']}" + (f":{s}" if (s := data.get("slice")) else ""),
        "content_hash": data["content_hash"],
        "code": f"mpdt {results.get('versions', {}).get('mpdt', '?')}",
        "command": command,
    }
    rows = []
    for mean in scores:
        protocol = _protocol(mean)
        if mean.task != MEAN or protocol is None or not math.isfinite(mean.mean):
            continue
        method = mean.method
        if label is not None and protocol != REFERENCE and method.startswith(own):
            method = label + method.removeprefix(own)
        of_tasks = [one for one in scores if (one.method, one.block) == (mean.method, mean.block)
                    and one.task != MEAN]  # fmt: skip
        whose = {"seed": "", "command": ""} if protocol == REFERENCE else {}
        rows.append(Row(
            **said | whose, protocol=protocol, method=method, mean=round(mean.mean, 4),
            success=None if mean.success is None else round(mean.success, 4),
            normalised=round(mean.normalised, 4), reads=mean.reads or "-",
            episodes=mean.num_episodes,
            levels=tuple((one.task, round(one.normalised, 4)) for one in of_tasks),
        ))  # fmt: skip
    return rows


def _protocol(score: Score) -> str | None:
    """None for references of training tasks, which no table shows."""
    if score.method in REFERENCES:
        return REFERENCE if score.block == "test" else None
    if score.block == "train":
        return TRAINED
    return protocol_of(score.reads, score.method) if score.reads else OUTSIDE


def standings(rows: Iterable[Row]) -> list[Standing]:
    """Rows put together that differ in their seeds alone, in the order of the first of each."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(row.group, []).append(row)
    return [_standing(tuple(sorted(own, key=lambda row: row.seed))) for own in groups.values()]


def _standing(rows: tuple[Row, ...]) -> Standing:
    levels = _levels(rows)
    low, high = stratified_interval(levels, iqm) if len(levels) > 1 else (math.nan, math.nan)
    return Standing(rows=rows, iqm=iqm(levels), low=low, high=high)


def board_csv(rows: Iterable[Row]) -> str:
    """The file's text: sorted, so that the same rows are the same bytes whatever came first."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(COLUMNS)
    for one in standings(sorted(rows, key=lambda row: row.key)):
        together = (_text(one.iqm), _text(one.low), _text(one.high), one.num_seeds)
        for row in one.rows:
            levels = " ".join(f"{task}={_text(value)}" for task, value in row.levels)
            writer.writerow([
                row.family, row.protocol, row.method, row.seed, _text(row.mean),
                _text(row.success), _text(row.normalised), *together, row.reads, row.episodes,
                row.horizon, row.data, row.content_hash, row.code, row.command, levels,
            ])  # fmt: skip
    return stream.getvalue()


def _text(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else f"{value:.4f}"


def read_board(path: Path) -> list[Row]:
    """The rows of a board. Raises: FormatError naming the line; StorageError."""
    try:
        table = list(csv.reader(io.StringIO(read_plain(path).decode("utf-8"))))
    except (UnicodeDecodeError, csv.Error) as error:
        raise _no_board(path, 1, str(error)) from error
    if not table or tuple(table[0]) != COLUMNS:
        raise _no_board(path, 1, ",".join(table[0]) if table else "nothing")
    rows: dict[Key, Row] = {}
    for number, cells in enumerate(table[1:], 2):
        try:
            row = _parsed(dict(zip(COLUMNS, cells, strict=True)))
        except ValueError as error:
            raise _no_board(path, number, str(error)) from error
        if row.key in rows:
            raise _no_board(path, number, f"a second row of {', '.join(row.key)}")
        rows[row.key] = row
    return list(rows.values())


def _parsed(cells: Mapping[str, str]) -> Row:
    """Raises: ValueError for a number that is none."""
    pairs = [pair.rpartition("=") for pair in cells["levels"].split(" ")]
    if not all(name for name, _, _ in pairs):
        raise ValueError("levels are no task=number")
    return Row(
        **{name: cells[name] for name in ("family", "protocol", "method", "seed", "reads", "data",
                                          "content_hash", "code", "command")},
        mean=float(cells["return"]),
        success=float(cells["success"]) if cells["success"] else None,
        normalised=float(cells["normalised"]),
        episodes=int(cells["episodes"]), horizon=int(cells["horizon"]),
        levels=tuple((name, float(value)) for name, _, value in pairs),
    )  # fmt: skip


def _no_board(path: Path, line: int, found: str) -> FormatError:
    return FormatError("not a leaderboard", where=f"{path}, line {line}", found=found[:200],
                       expected="a row as `mpdt-train submit` writes it",
                       hint="take the file from version control, or move it away: submit begins "
                            "a new one")  # fmt: skip
