"""Options every verb has, and where its words go: results to stdout, talk to stderr."""

from __future__ import annotations

import json
import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from tyro.conf import arg

from mpdt.errors import visible, visible_json

Names = Annotated[tuple[str, ...], arg(metavar="NAME[,NAME...]")]


@dataclass(frozen=True, kw_only=True)
class Options(ABC):
    json: bool = False
    """Print results as one JSON document."""
    quiet: Annotated[bool, arg(aliases=["-q"])] = False
    """No progress and no remarks on stderr."""
    verbose: Annotated[bool, arg(aliases=["-v"])] = False
    """Show the traceback of an error."""
    color: Literal["auto", "never"] = "auto"
    """Colour on terminals only, or never."""

    @abstractmethod
    def run(self) -> None:
        """Do it. Raises: MpdtError."""

    def say(self, line: str) -> None:
        """A remark for whoever watches."""
        if not self.quiet:
            sys.stderr.write(visible(line) + "\n")
            sys.stderr.flush()

    def print(self, result: Any, text: str) -> None:
        """The result: as JSON if asked for, else as text."""
        print_result(result, text, self.json)


def how_to_go_on(again: str, once: bool) -> str:
    """What to say after a signal: the same command, unless it was done already.

    Args:
        again: that command.
        once: it replaces nothing, not even what it has made itself.
    """
    from mpdt.disk import last_put

    if once and (path := last_put()) is not None:
        return visible(f"interrupted; {path} is whole, nothing is left to do")
    return visible(f"interrupted; go on with: {again}")


def print_result(result: Any, text: str, as_json: bool) -> None:
    """On stdout: one JSON document, or text as it can be shown."""
    if as_json:
        plain = _with_null(result)
        is_short = not str(getattr(sys.stdout, "encoding", "")).lower().startswith("utf")
        text = json.dumps(plain, ensure_ascii=is_short, allow_nan=False, indent=1)
        text = visible_json(text)
    sys.stdout.write(visible(text.rstrip("\n"), lines=True) + "\n")
    sys.stdout.flush()


def _with_null(value: Any) -> Any:
    """JSON has no NaN and no infinity."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _with_null(item) for key, item in value.items()}
    return [_with_null(item) for item in value] if isinstance(value, list | tuple) else value


def split_names(names: Sequence[str]) -> tuple[str, ...]:
    """`a,b c` typed as one or several words, as names."""
    return tuple(name for word in names for name in word.split(",") if name)


def split_steps(names: Sequence[str], where: str) -> tuple[int, ...]:
    """`200,500` as episode lengths. Raises: UsageError for what is no length."""
    from mpdt.errors import UsageError

    found = split_names(names)
    if wrong := [name for name in found if not name.isdigit() or int(name) == 0]:
        raise UsageError("not an episode length", where=where,
                         expected="steps, such as 200,500", found=wrong[0])  # fmt: skip
    return tuple(int(name) for name in found)


def text_table(rows: Sequence[Sequence[str]], numbers_from: int = 1) -> str:
    """Rows as aligned columns, the first row a heading; right-aligned from `numbers_from` on."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [
            cell.rjust(width) if place >= numbers_from else cell.ljust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def number(value: float, digits: int = 1) -> str:
    """`-36.1`, or `-` for a value that was never measured."""
    return "-" if value != value else f"{value:,.{digits}f}"


def or_none(value: float) -> float | None:
    """NaN as JSON's null."""
    return None if value != value else value
