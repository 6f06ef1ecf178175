"""Table: text cells, drawn as Markdown for pages, HTML for notebooks, rich for the terminal."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

from mpdt.errors import visible

if TYPE_CHECKING:
    from rich.table import Table as RichTable


_WORDS = re.compile(r"[A-Za-z]{2}.* .*[A-Za-z]{2}")


@dataclass(frozen=True)
class Table:
    """Rows of cells under named columns, the first of which names the row.

    Args:
        notes: lines below the table.
        closing: the last so many rows sum up those above and stand apart on the terminal.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    closing: int = 0

    @property
    def columns_of_words(self) -> set[int]:
        """Positions of columns that hold words: these wrap, numbers do not."""
        return {at for at in range(len(self.columns))
                if any(_WORDS.search(row[at]) for row in self.rows)}  # fmt: skip


def markdown_table(
    columns: Sequence[str], rows: Iterable[Sequence[object]], numbers: bool = True
) -> str:
    """Lines of a table; a `|` within a cell is escaped.

    Args:
        numbers: all columns but the first stand to the right.
    """
    rule = ["---"] + ["---:" if numbers else "---"] * (len(columns) - 1)
    return "\n".join(markdown_line(cells) for cells in (columns, rule, *rows))


def markdown_page(header: Mapping[str, str], tables: Sequence[Table], closing: str = "") -> str:
    """A page named `header["name"]`: the rest of the header as a list, the tables, a last line."""
    parts = ["# " + header.get("name", "run"), ""]
    parts += [f"- {key}: {value}" for key, value in header.items() if key != "name"]
    for table in tables:
        parts += ["", f"## {table.title}", "", markdown_table(table.columns, table.rows)]
        for note in table.notes:
            parts += ["", note]
    parts += ["", closing] if closing else []
    return "\n".join(parts) + "\n"


def html_table(table: Table) -> str:
    """One table as a notebook shows it; whatever stands in a cell is text there."""

    def line(tag: str, cells: Iterable[object]) -> str:
        sides = ("left", "right")
        shown = (
            f'<{tag} style="text-align:{sides[i > 0]}">{escape(visible(str(cell)))}</{tag}>'
            for i, cell in enumerate(cells)
        )
        return f"<tr>{''.join(shown)}</tr>"

    body = "".join(line("td", row) for row in table.rows)
    notes = "".join(f"<p>{escape(visible(note))}</p>" for note in table.notes)
    return (
        f"<div><p><b>{escape(visible(table.title))}</b></p>"
        f"<table><thead>{line('th', table.columns)}</thead><tbody>{body}</tbody></table>"
        f"{notes}</div>"
    )


def rich_tables(tables: Sequence[Table]) -> list[RichTable]:
    """The same for a `rich.console.Console`; cells are text, whatever brackets are in them."""
    from rich.table import Table as RichTable
    from rich.text import Text

    def text(cell: object) -> Text:
        return Text(visible(str(cell)))

    drawn = []
    for table in tables:
        rich = RichTable(title=text(table.title), title_justify="left")
        for i, column in enumerate(table.columns):
            rich.add_column(text(column), justify="right" if i else "left", no_wrap=not i)
        for i, row in enumerate(table.rows):
            rich.add_row(*map(text, row), end_section=i + 1 == len(table.rows) - table.closing)
        notes = Text("\n").join(map(text, table.notes))
        rich.caption, rich.caption_justify = notes if table.notes else None, "left"
        drawn.append(rich)
    return drawn


def markdown_line(cells: Iterable[object]) -> str:
    """One row, for tables that come row by row; a head is a table without rows."""
    return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"
