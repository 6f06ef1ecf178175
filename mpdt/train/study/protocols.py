"""One table for all families by protocol: what a policy may read of an unseen task first.

    nothing                  the task is not told
    the task's name          which training task it is: known tasks, other goals
    X                        random episodes without rewards: the published protocol
    X and rewards            the same with the simulator's rewards ("inferred")
    own episodes             K of its own, with rewards and successes (docs/decisions/0033)
    labelled steps           200 expert steps, or a demonstration

Per family and protocol the row that earns most stands there with the number of rows it is the best
of: chosen by what it earned on test tasks, so a little above what the next seed will earn.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from mpdt.draw.table import Table
from mpdt.train.evaluate.score import REFERENCES
from mpdt.train.study.cells import CellResult
from mpdt.train.study.once import NOTHING
from mpdt.train.study.summary import Row, summarise

ZERO_SHOT: tuple[str, ...] = (*NOTHING, "X", "X+rewards")
FEW_SHOT: tuple[str, ...] = ("labelled steps", "demonstration")
TRIALS: tuple[str, ...] = ("trials",)
X_AND_TRIALS: tuple[str, ...] = ("X+rewards, trials",)
COUNTS = (1, 3, 10)
_OWN = re.compile(r"(\d+) own episodes?$")


def own_episodes(count: int) -> str:
    return f"{count} own episode" + "s" * (count != 1)


def split_own(method: str) -> tuple[str, int]:
    """A row's name without the number of its own episodes, and that number; 0 = none.

    ones-alone 10 own episodes -> ones-alone, 10
    """
    found = _OWN.search(method)
    return (method[: found.start()].rstrip(), int(found[1])) if found else (method, 0)


def has_own_episodes(method: str, count: int) -> bool:
    """Whether a row read so many episodes of its own on each test task; 0 = none."""
    return split_own(method)[1] == count


@dataclass(frozen=True)
class Protocol:
    """Rows that may be compared, because they read the same."""

    name: str
    reads: tuple[str, ...]
    own: int = 0


TOLD_NAME = Protocol("the task's name", ("task id",))
PROTOCOLS = (
    Protocol("nothing", ("nothing",)),
    TOLD_NAME,
    Protocol("X alone (published)", ("X",)),
    Protocol("X and rewards, inferred", ("X+rewards",)),
    *(Protocol(own_episodes(count), TRIALS, count) for count in COUNTS),
    *(Protocol(f"X, rewards, {own_episodes(count)}", X_AND_TRIALS, count) for count in COUNTS),
    Protocol("labelled steps or a demonstration", FEW_SHOT),
)


def protocol_of(reads: str, method: str) -> str:
    """The name of the protocol of a row that read `reads`."""
    count = split_own(method)[1]
    for one in PROTOCOLS:
        if reads in one.reads and one.own == count:
            return one.name
    return f"X, rewards, {own_episodes(count)}" if reads in X_AND_TRIALS else own_episodes(count)


def protocols_table(cells: Sequence[CellResult]) -> Table:
    """Per data set the references, then of each protocol the row that earns most."""
    columns = ("data", "read of an unseen task", "mean return", "95 % interval", "success",
               "normalised", "method", "seeds", "best of")  # fmt: skip
    lines, missing = [], []
    for data in dict.fromkeys(cell.data for cell in cells):
        own = [cell for cell in cells if cell.data == data]
        lines += list(_lines(data, own))
        told = {line[1] for line in lines if line[0] == data}
        # Only known tasks have a name that could be told.
        absent = [one.name for one in PROTOCOLS if one.name not in told and one is not TOLD_NAME]
        missing += [f"{data}: no row that reads {', '.join(absent)}"] if absent else []
    notes = ("seeds: of training; runs: these times seeds of trials; weights that several labels "
             "judged without reading anything are one row",)  # fmt: skip
    return Table("By protocol, on unseen tasks", columns, tuple(lines), (*notes, *missing))


def _lines(data: str, cells: Sequence[CellResult]) -> Iterator[tuple[str, ...]]:
    rows = summarise(cells, "test")
    for row in rows:
        if row.method in REFERENCES and math.isfinite(row.mean):
            yield (data, row.method, *_numbers(row), "-", "-", "-")
    for protocol in PROTOCOLS:
        known = [
            row for row in rows
            if row.reads in protocol.reads and has_own_episodes(row.method, protocol.own)
        ]  # fmt: skip
        if known:
            best = max(known, key=lambda row: row.mean)
            yield (data, protocol.name, *_numbers(best), best.method,
                   best.seeds, str(len(known)))  # fmt: skip


def _numbers(row: Row) -> tuple[str, str, str, str]:
    low, high = row.interval
    interval = f"[{low:.1f}, {high:.1f}]" if math.isfinite(low + high) else "-"
    success = "-" if row.success is None else f"{row.success:.0%}"
    return f"{row.mean:.1f}", interval, success, f"{row.normalised:.2f}"
