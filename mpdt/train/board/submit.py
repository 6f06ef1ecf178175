"""`mpdt-train submit`: a result's rows go to the leaderboard, if its data is locked.

    runs/NAME, a study's cell, what `evaluate --policy --json` printed
        complete?  its content hash in datasets.lock?  ──>  rows, beside those that are there

A row that is there already stays; another one of the same family, protocol, method and seed is
refused, unless it is to be replaced or has a name of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpdt.data.lock.file import LockEntry, read_lock
from mpdt.disk import holding, write_bytes
from mpdt.errors import DataError, FormatError, UsageError, quoted
from mpdt.reading import read_plain
from mpdt.train.board.rows import REFERENCE, Key, Row, board_csv, read_board, rows_of
from mpdt.train.evaluate.score import REFERENCES
from mpdt.train.run.identity import from_record
from mpdt.train.run.results import read_results, read_results_file, scores_in
from mpdt.train.run.show import command_text
from mpdt.train.study.plans import STUDIES

HEAD = b"family,protocol,method,seed"
_JUDGE = (
    "mpdt-train --data FILE makes a run, mpdt-train evaluate --policy ... --json prints a result"
)


@dataclass(frozen=True)
class Submitted:
    """What became of it."""

    added: tuple[Row, ...]
    same: int
    """Rows that stood there already."""
    replaced: int
    remade: bool
    """Whether numbers that are made of all rows were made again, as this version makes them."""


def submit(
    places: Sequence[Path], board: Path, lock: Path, label: str | None = None,
    replace: bool = False,
) -> Submitted:  # fmt: skip
    """Add the rows of results to `board`, which is begun if it is not there: all or none.

    Args:
        places: folders of runs, or files with a result.
        lock: the datasets.lock that has to hold their data.
        label: another name of the method.
        replace: rows of the same key.
    Raises: UsageError for an incomplete run, a row that is there with other numbers, a name that
        a table cannot show or that is a reference's; DataError
        for data that is not locked; FormatError, MissingFileError, StorageError.
    """
    if label is not None and (not label.strip() or not label.isprintable()
                              or "|" in label or label in REFERENCES):  # fmt: skip
        raise UsageError(
            "no name of a method",
            where="--as",
            found=repr(label)[:80],
            expected=f"one line, without |, none of {', '.join(REFERENCES)}",
        )
    entries = read_lock(lock)
    found = [(where, rows_at(where, entries, lock, label)) for where in places]
    with holding(board, amends=True):
        known = {row.key: row for row in read_board(board)} if board.exists() else {}
        added: dict[Key, Row] = {}
        same = replaced = 0
        for where, rows in found:
            for row in rows:
                before = added.get(row.key, known.get(row.key))
                # References come with every result, over its own evaluation seeds: the first stays.
                if before is not None and (before == row or row.protocol == REFERENCE):
                    same += 1
                    continue
                if before is not None and not (replace and row.key not in added):
                    raise _another(before, row, where)
                replaced += before is not None
                added[row.key] = row
        text = board_csv((known | added).values()).encode()
        # What the columns are made of may have changed since it was written (iqm, low, high).
        remade = bool(known) and not added and read_plain(board) != text
        if added or remade:
            write_bytes(board, text, amends=True, like=HEAD)
    return Submitted(tuple(added.values()), same, replaced, remade)


def rows_at(
    where: Path, entries: Mapping[str, LockEntry], lock: Path, label: str | None = None
) -> list[Row]:
    """The rows of a result, whose data is among the `entries` of `lock`. Raises: as `submit`."""
    if not where.exists():
        raise UsageError("no result there", where=str(where), hint=_JUDGE)
    results = read_results(where) if where.is_dir() else read_results_file(where)
    path = str(where)
    try:
        data = results["data"]
        said = {key: data[key] for key in ("name", "version", "content_hash", "horizon")}
    except (KeyError, TypeError) as error:
        raise FormatError("not a result of a run or a policy", where=path,
                          found=f"no {error.args[0]} of its data",
                          hint=_JUDGE) from error  # fmt: skip
    if results.get("complete") is False:
        raise UsageError("this run was ended by its time limit", where=path,
                         hint="the same mpdt-train command trains on")  # fmt: skip
    check_locked(said, entries.get(str(said["name"])), path, lock)
    rows = rows_of(
        results, scores_in(results), str(said["name"]), command_of(results, where), label
    )
    if all(row.protocol == REFERENCE for row in rows):
        raise UsageError("nothing in it but references", where=path, hint=_JUDGE)
    for row in rows:
        if not all(map(math.isfinite, (row.normalised, *(level for _, level in row.levels)))):
            raise UsageError(f"{row.method} has no level, and a board compares levels", where=path,
                             expected="episodes as long as those of the data's references",
                             found=f"{row.horizon} steps an episode",
                             hint="judge it with --evaluation.horizon 0, as the data has it; data "
                                  "without references of random and expert has none")  # fmt: skip
    return rows


def check_locked(said: Mapping[str, Any], entry: LockEntry | None, where: str, lock: Path) -> None:
    """Raises: DataError unless the lock holds exactly these episodes."""
    name = str(said["name"])
    if entry is None:
        raise DataError(f"made on data that {lock} does not hold", where=where, found=name,
                        expected="a data set of that lock",
                        hint=f"mpdt-data collect {quoted(name)} adds an entry of datasets.yaml; "
                             "what was cut, merged or imported nobody can make again")  # fmt: skip
    if entry.hashes.content != said["content_hash"]:
        raise DataError(f"made on other episodes of {name} than {lock} holds", where=where,
                        expected=f"content {entry.hashes.content[:12]}",
                        found=str(said["content_hash"])[:12],
                        hint=f"mpdt-data collect {quoted(name)} --locked makes the locked ones; "
                             "train on those")  # fmt: skip


def command_of(results: Mapping[str, Any], where: Path) -> str:
    """What makes the result again."""
    data, cell = f"{results['data']['name']}.h5", results.get("cell")
    if cell is not None:
        studies = [name for name, cells in STUDIES.items() if cell in {one.name for one in cells}]
        if studies:
            study = where.parent.name if where.parent.name in studies else studies[0]
            return f"mpdt-train study {quoted(study)} --only {quoted(cell)} --restart"
    if "config" in results:
        sliced = f"{data}:{s}" if (s := results["data"].get("slice")) else data
        return command_text(from_record(results["config"]), sliced)
    policy = str(results.get("name", "?"))
    return f"mpdt-train evaluate --policy {quoted(policy)} --data {quoted(data)}"


def _another(known: Row, row: Row, where: Path) -> UsageError:
    return UsageError(
        f"the board has another row of {row.family}, {row.protocol}: {row.method}, "
        f"seed {row.seed or 'unknown'}", where=str(where),
        expected=f"return {known.mean:g}, made by: {known.command}", found=f"{row.mean:g}",
        hint="--as NAME gives the method a name of its own, --replace puts this row in its place",
    )  # fmt: skip
