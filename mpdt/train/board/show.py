"""What `mpdt-train submit` prints: the rows that were added, and where they stand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from mpdt.data.lock.file import lock_path
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.verbs.options import number, print_result, text_table
from mpdt.errors import UsageError
from mpdt.train.board.rows import REFERENCE, Row, Standing, read_board, standings
from mpdt.train.board.submit import submit

if TYPE_CHECKING:
    from mpdt.train.options import Submit


def submit_and_show(command: Submit) -> int:
    """Exit code. Raises: as `submit`; UsageError for no result at all."""
    if not command.results:
        raise UsageError("no result named", where="mpdt-train submit",
                         hint="mpdt-train submit runs/NAME")  # fmt: skip
    lock = lock_path(load_catalog().path) if command.lock is None else command.lock
    if not lock.exists():
        raise UsageError("no lock there, so nothing can be told from data of one's own",
                         where=str(lock),
                         hint="--lock FILE, such as that of the repository")  # fmt: skip
    done = submit(command.results, command.board, lock, command.label, command.replace)
    rows = [row for row in done.added if row.protocol != REFERENCE]
    heading = f"{command.board}   {len(done.added)} rows added, {done.same} were there"
    heading += f", {done.replaced} replaced" if done.replaced else ""
    heading += ", IQM and intervals made again" if done.remade else ""
    text = "\n".join([heading, *([_table(rows, command.board)] if rows else [])])
    print_result([msgspec.to_builtins(row) for row in done.added], text, command.json)
    return 0


def _table(rows: list[Row], board: Path) -> str:
    all_rows = standings(read_board(board))
    lines = [("family", "protocol", "method", "seed", "return", "success", "level", "place")]
    for row in rows:
        success = "-" if row.success is None else f"{row.success:.0%}"
        lines.append((row.family, row.protocol, row.method, row.seed or "-", number(row.mean),
                      success, number(row.normalised, 2), _place(row, all_rows)))  # fmt: skip
    return text_table(lines, numbers_from=3)


def _place(row: Row, board: list[Standing]) -> str:
    """By the mean return over all seeds, among the methods of the same family and protocol."""
    place = row.family, row.protocol
    rivals = [one for one in board if (one.rows[0].family, one.rows[0].protocol) == place]
    own = next(one for one in rivals if row.key in {each.key for each in one.rows})
    return f"{1 + sum(one.mean > own.mean for one in rivals)} of {len(rivals)}"
