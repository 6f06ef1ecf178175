"""The leaderboard as a page and pictures: docs/leaderboard.md, one SVG file per family.

a table per family     the best rows of each protocol, with the references
a picture per family   profiles: share of tasks and seeds above a level, the best of each protocol
                       chances: that the first of a protocol beats each of the next on a task
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mpdt.draw.chart import Axis, Chart, Dot, line, row_chart
from mpdt.draw.sheet import Sheet, write_sheet
from mpdt.draw.table import markdown_table
from mpdt.errors import FormatError
from mpdt.reading import read_plain
from mpdt.train.board.rows import REFERENCE, TRAINED, Row, Standing, standings
from mpdt.train.evaluate.aggregate import improvement, profile
from mpdt.train.study.once import place_in_studies
from mpdt.train.study.protocols import PROTOCOLS, TOLD_NAME

READS_NOTHING = ("nothing", TOLD_NAME.name)
"""Protocols in which the same weights, judged again, are the same policy."""
BEST = 6
"""Rows of a protocol that the page shows."""
WIDE, LETTERS = 720, 56
HEADINGS = ("method", "seeds", "return", "success", "level", "IQM", "95 % interval", "made by")
PUBLISHED = ("family", "read of an unseen task", "method", "figure", "who", "differences")
ABOUT = """# Leaderboard

Written by `make results` from `results/leaderboard.csv`; do not edit. The file has one line per
data set, protocol, method and seed, with the level of every task, the hash of the data and the
command that makes the line again; this page shows the best {best} methods of each protocol.

- **protocol**: what was read of an unseen task before its first step. Only rows of one protocol
  compete. Of mt10 and mt50 an unseen task is a known one with other goals, and may be told by name.
  What a policy of yours has read nobody but you can know: `--reads`.
- **level**: 0 is the random policy of the file, 1 its expert; mean over tasks and seeds. **IQM**:
  the mean of the middle half of all levels of tasks and seeds; its interval resamples seeds within
  a task, so one seed has none. Both as Agarwal et al. 2021 define them; `rliable` gives the same
  numbers (`tests/train/evaluate/test_rliable.py`). Runs of one training seed that differ in the
  seed of their trials are averaged before: "3 (9 runs)" has three seeds.
- **made by**: study and name of the first seed's cell, which
  `mpdt-train study STUDY --only CELL --restart` makes again; else the whole command.
- **The first of many** is flattered, the more so the more methods a protocol has; "6 of N" says how
  many.

Add rows of yours, from a run, a study's cell or a judged policy. Data that `datasets.lock` does not
hold is refused:

```
mpdt-train submit runs/NAME --board results/leaderboard.csv
mpdt-train evaluate --policy mine:act --data ml10.h5 --reads nothing --json > mine.json
mpdt-train submit mine.json --board results/leaderboard.csv
```
"""
OTHERS = """## Published by others

For orientation: horizons, versions of the rewards, data and what is read of a task differ, as far
as known as said in the last column. None of these was run here, and none may be set beside a row
above without its differences. "Second hand": not from the authors' own text.

"""


def board_page(rows: Sequence[Row], published: Sequence[Sequence[str]], pictures: str) -> str:
    """The page's text.

    Args:
        published: rows of `read_published`.
        pictures: folder of the pictures, seen from the page.
    """
    parts = [ABOUT.format(best=BEST)]
    for family in dict.fromkeys(row.family for row in rows):
        own = standings(row for row in rows if row.family == family)
        first = own[0].rows[0]
        parts.append(f"## {family}\n")
        parts.append(f"Data: {first.data}, content `{first.content_hash}`, {first.horizon} steps "
                     "an episode.")  # fmt: skip
        for protocol in _protocols(own):
            ranked = ranking(own, protocol)
            shown = ranked if protocol == REFERENCE else ranked[:BEST]
            more = f", {BEST} of {len(ranked)}" if len(shown) < len(ranked) else ""
            plain = protocol in (REFERENCE, TRAINED)
            parts.append(f"\n### {family}{': ' if plain else ', reads '}{protocol}{more}\n")
            parts.append(markdown_table(HEADINGS, map(_line, shown)))
        parts.append(f"\n![Profiles and chances of {family}]({pictures}/{picture_name(family)})\n")
    parts.append(OTHERS + markdown_table(PUBLISHED, published, numbers=False))
    return "\n".join(parts) + "\n"


def _line(one: Standing) -> tuple[str, ...]:
    row, is_known = one.rows[0], one.rows[0].protocol == REFERENCE
    interval = f"[{one.low:.2f}, {one.high:.2f}]" if one.low == one.low else "-"
    return (
        one.method, "-" if is_known else one.seeds, f"{one.mean:,.1f}",
        "-" if one.success is None else f"{one.success:.0%}", f"{one.normalised:.2f}",
        f"{one.iqm:.2f}", interval, f"`{_made_by(row.command)}`" if row.command else "-",
    )  # fmt: skip


def _made_by(command: str) -> str:
    """A cell by its study and name, which the page says how to run; anything else as it is."""
    cell = re.fullmatch(r"mpdt-train study (\S+) --only (\S+) --restart", command)
    return f"{cell[1]} {cell[2]}" if cell else command


def _protocols(own: Sequence[Standing]) -> list[str]:
    """The references, then what reads less before what reads more; training tasks last."""
    known = [REFERENCE, *(one.name for one in PROTOCOLS)]
    there = {one.rows[0].protocol for one in own}
    others = sorted(there - {*known, TRAINED})
    return [name for name in (*known, *others, TRAINED) if name in there]


def ranking(own: Sequence[Standing], protocol: str) -> list[Standing]:
    """The methods of a protocol by mean return, best first."""
    found = [one for one in own if one.rows[0].protocol == protocol]
    if protocol in READS_NOTHING:
        found = _told_once(found)
    return sorted(found, key=lambda one: (-one.mean, one.rows[0].method))


def _told_once(found: Sequence[Standing]) -> list[Standing]:
    """Without methods all of whose rows are those of another one: the same weights, judged again.

    A board does not know weights; nobody else has the same levels on every task.
    """

    def place(one: Standing) -> tuple[int, int]:
        row = one.rows[0]
        return -len(one.rows), place_in_studies(row.family, one.method.split(" ")[0])

    kept: list[Standing] = []
    seen: set[tuple[float, tuple[tuple[str, float], ...]]] = set()
    for one in sorted(found, key=place):
        rows = {(row.mean, row.levels) for row in one.rows}
        if not rows <= seen:
            kept.append(one)
            seen |= rows
    return kept


def read_published(path: Path) -> list[list[str]]:
    """Figures of others. Raises: FormatError for other columns; StorageError."""
    table = list(csv.reader(io.StringIO(read_plain(path).decode("utf-8"))))
    if not table or tuple(table[0]) != PUBLISHED or {len(row) for row in table} != {len(PUBLISHED)}:
        raise FormatError("not a table of published figures", where=str(path),
                          expected=",".join(PUBLISHED), found=",".join(table[0] if table else ()),
                          hint="take it from version control")  # fmt: skip
    return table[1:]


# ---- pictures ----


def picture_name(family: str) -> str:
    return f"{family}-leaderboard.svg"


def draw_board(rows: Sequence[Row], folder: Path) -> list[Path]:
    """One picture per family. Raises: StorageError."""
    made = []
    for family in dict.fromkeys(row.family for row in rows):
        own = standings(row for row in rows if row.family == family)
        ranked = [ranking(own, protocol) for protocol in _protocols(own)[1:]]
        firsts = [found[0] for found in ranked]
        charts = [profile_chart(firsts)]
        charts += [chance_chart(found[: BEST + 1]) for found in ranked if len(found) > 1]
        legend = [(f"c{i}", f"{one.rows[0].protocol}: {one.method}")
                  for i, one in enumerate(firsts)]  # fmt: skip
        made.append(folder / picture_name(family))
        title = f"{family}: the best method of each protocol, and how sure its place is"
        write_sheet(made[-1], Sheet(title, charts, legend))
    return made


def profile_chart(methods: Sequence[Standing]) -> Chart:
    """Share of tasks and seeds whose level is above x, a line per method."""
    levels = [value for one in methods for value in one.levels.ravel().tolist()]
    low, high = min(0.0, *levels), max(1.0, *levels)
    at = np.linspace(max(low, -1.0), min(high, 1.5), 201)
    marks = tuple(line(f"c{i}", at, profile(one.levels, at)) for i, one in enumerate(methods))
    x = Axis(float(at[0]), float(at[-1]), "level: 0 random, 1 expert")
    drawn = Chart("share of tasks and seeds above a level", x, Axis(0.0, 1.0), marks)
    return replace(drawn, width=WIDE)


def chance_chart(ranked: Sequence[Standing]) -> Chart:
    """Chance that a seed of the first beats a seed of each other on one task."""
    first, rows = ranked[0], []
    for one in ranked[1:]:
        if one.levels.shape[1] == first.levels.shape[1]:
            chance = improvement(first.levels, one.levels)
            rows.append((f"{one.method}, {one.seeds}", [Dot("c0", chance)]))
    name = f"{first.rows[0].protocol}: chance that {first.method} beats, on one task,"
    drawn = row_chart(
        name, rows, Axis(0.0, 1.0, "chance, 1/2 = neither; behind the comma the seeds"), bars=True
    )
    return replace(drawn, width=WIDE, letters=LETTERS)
