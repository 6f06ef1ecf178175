"""What several cells are doing at once, on stderr: a table on a terminal, else a line per cell.

ml10.MPDT.s0           student         120/600  1:20 left    action loss 0.0124
cheetah_vel.MPDT.s0    test: MPDT      100/200  0:04 left
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TextIO

from mpdt.errors import visible
from mpdt.pace import Pace


class Live:
    """Args:
    quiet: show nothing.
    """

    def __init__(self, quiet: bool = False, stream: TextIO | None = None) -> None:
        self._quiet, self._stream = quiet, stream or sys.stderr
        self._pace = Pace()
        self._table: Any = None
        self._told: dict[str, str] = {}

    @contextmanager
    def shown(self) -> Iterator[Live]:
        """On a terminal the table stands below everything else that is written meanwhile."""
        if self._quiet or not self._stream.isatty():
            yield self
            return
        from rich.console import Console
        from rich.live import Live as RichLive

        console = Console(file=self._stream)
        with RichLive(console=console, refresh_per_second=4, transient=True) as self._table:
            yield self
        self._table = None

    def say(self, line: str) -> None:
        """One line of its own."""
        if self._quiet:
            return
        if self._table is not None:
            self._table.console.print(visible(line), markup=False, highlight=False)
            return
        self._stream.write(visible(line) + "\n")
        self._stream.flush()

    def show(self, lines: Mapping[str, str]) -> None:
        """Where every cell that runs is now, by its name."""
        if self._quiet:
            return
        width = max(map(len, lines), default=0)
        rows = {name: f"{name:<{width}}  {line}".rstrip() for name, line in lines.items()}
        if self._table is not None:
            from rich.text import Text

            self._table.update(Text(visible("\n".join(rows.values()), lines=True)))
        elif self._pace.is_time():
            for name, row in rows.items():
                if self._told.get(name) != row:
                    self.say(row)
            self._told = dict(rows)
