"""Errors a user can cause, each with the exit code of the command line.

    MpdtError                       1   base: what, where, expected, found, hint
    ├── UsageError                  2   unknown verb, option value or name
    │   └── SpecError               2   datasets.yaml or a preset says something impossible
    ├── MissingFileError            2   a path that is not there
    ├── DataError                   1   a file whose content is wrong
    │   ├── FormatError             1   not an mpdt file, or another format version
    │   └── ShapeError              1   arrays whose shapes or dtypes disagree
    ├── StorageError                1   the disk refused: full, read-only, no permission
    ├── RemoteError                 1   the other side refused, or the connection broke
    ├── SimulatorError              3   simulator missing or of another version
    ├── BusyError                   4   another process writes the target
    ├── BackboneError               2   language model unknown, unreachable or not whole
    └── TrainingError               1   training cannot go on (NaN, mismatched checkpoint)

Every class also derives from the builtin a library user would catch. Mistakes of our own
are `assert`s and never appear here.
"""

from __future__ import annotations

import difflib
import json
import math
import re
import shlex
from collections.abc import Iterable
from pathlib import PurePath


class MpdtError(Exception):
    """Something the user can mend.

    Args:
        what: what is wrong; one line, or `Lines`.
        where: file, key or episode it is about.
        expected, found: the two sides of the disagreement, where there are two.
        hint: what to do next, ideally a command to type.
    """

    exit_code = 1

    def __init__(
        self, what: str, *, where: str = "", expected: str = "", found: str = "", hint: str = ""
    ) -> None:
        self.what, self.where, self.expected, self.found = what, where, expected, found
        self.hint = hint
        super().__init__(self._text(_shown(what)))

    def message(self) -> str:
        """One line: `where: what; expected E, found F`, with nothing a terminal would obey."""
        heading, *lines = map(str.strip, _shown(self.what).splitlines() or [""])
        told = "; ".join(filter(None, lines))
        return self._text(f"{heading.rstrip(':')}: {told}" if told else heading)

    def _text(self, what: str) -> str:
        line = f"{_shown(self.where)}: {what}" if self.where else what
        sides = [f"expected {_shown(self.expected)}"] if self.expected else []
        sides += [f"found {_shown(self.found)}"] if self.found else []
        return "; ".join([line, ", ".join(sides)]) if sides else line

    def render(self) -> str:
        """The text the command lines print on stderr, without colour."""
        text = f"error: {self._text(_shown(self.what))}"
        return f"{text}\nhint:  {_shown(self.hint)}" if self.hint else text

    def with_hint(self, hint: str) -> MpdtError:
        """The same, where somebody knows better what to do next."""
        return _rebuild(type(self), self.what, self.where, self.expected, self.found, hint)

    def __reduce__(self) -> tuple[object, ...]:
        # Exceptions cross process borders; the default would lose the keyword arguments.
        fields = (self.what, self.where, self.expected, self.found, self.hint)
        return _rebuild, (type(self), *fields)


def _rebuild(
    kind: type[MpdtError], what: str, where: str, expected: str, found: str, hint: str
) -> MpdtError:
    return kind(what, where=where, expected=expected, found=found, hint=hint)


class UsageError(MpdtError, ValueError):
    exit_code = 2


class SpecError(UsageError):
    pass


class MissingFileError(MpdtError, FileNotFoundError):
    exit_code = 2

    # OSError.__new__ and __str__ read positional arguments in their own way.
    def __str__(self) -> str:
        return str(self.args[0])


class DataError(MpdtError, ValueError):
    pass


class FormatError(DataError):
    pass


class ShapeError(DataError):
    pass


class StorageError(MpdtError, OSError):
    def __str__(self) -> str:
        return str(self.args[0])


class RemoteError(MpdtError, ConnectionError):
    def __str__(self) -> str:
        return str(self.args[0])


class SimulatorError(MpdtError, RuntimeError):
    exit_code = 3


class BusyError(MpdtError, RuntimeError):
    exit_code = 4


class BackboneError(UsageError):
    pass


class TrainingError(MpdtError, RuntimeError):
    pass


def told(error: MpdtError | OSError) -> MpdtError:
    """An error as the command lines tell it; also of a path that the system will not look at.

    Raises: OSError, the same, where it is about no path.
    """
    if isinstance(error, MpdtError):
        return error
    if error.filename is None:
        raise error
    return StorageError("the system refuses", where=str(error.filename), found=str(error.strerror))


class Lines(str):
    """Several lines, the first of them a heading; a line end inside of one is shown as text."""

    @classmethod
    def of(cls, heading: str, *lines: str) -> Lines:
        return cls("\n  ".join(map(visible, (heading, *lines))))


_LONG = re.compile(r"\S{513,}")
"""No name is as long; a terminal would show nothing else."""


def _shown(text: str) -> str:
    """As a terminal may show it, with the middle of endless words left out."""
    short = _LONG.sub(lambda word: f"{word[0][:160]}[...]{word[0][-80:]}", text)
    return visible(short, lines=isinstance(text, Lines))


def visible(text: str, lines: bool = False) -> str:
    """The text as a terminal may show it: control characters, and those that turn the direction
    of writing, as `\\x1b` and `\\u202e`. Names in a file may hold any.

    Args:
        lines: line ends and tabs stay.
    """
    if text.isprintable():
        return text
    return "".join(
        char if char.isprintable() or (lines and char in "\n\t") else _escaped(char)
        for char in text
    )


def visible_json(text: str) -> str:
    """JSON text of the same value in which such characters are escaped as JSON has it."""
    if text.isprintable():
        return text
    return "".join(
        char if char.isprintable() or char == "\n" else json.dumps(char)[1:-1] for char in text
    )


def _escaped(char: str) -> str:
    return char.encode("unicode_escape").decode("ascii")


def quoted(word: object) -> str:
    """A value as one word of a command that somebody will type."""
    text = str(word)
    if not text.isprintable():  # what a shell takes for it, and a terminal does not obey
        return "$'" + "".join(map(_in_shell, text)) + "'"
    is_option = isinstance(word, PurePath) and text.startswith("-")
    return shlex.quote(f"./{text}" if is_option else text)


def _in_shell(char: str) -> str:
    if char in "\\'":
        return f"\\{char}"
    if "\udc80" <= char <= "\udcff":  # a byte of a file name that is no text
        return f"\\x{ord(char) - 0xDC00:02x}"
    return char if char.isprintable() else _escaped(char)


def nearest(name: str, known: Iterable[str]) -> str:
    """`(did you mean 'x'?)` for the closest known name, or an empty string."""
    matches = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"(did you mean '{matches[0]}'?)" if matches else ""


def unknown_name(kind: str, name: str, known: Iterable[str], where: str = "") -> UsageError:
    """`UsageError` for a name that is not one of `known`, with the nearest and all of them."""
    known, name = sorted(known), str(name)
    what = " ".join(part for part in (f"unknown {kind} '{name}'", nearest(name, known)) if part)
    return UsageError(what, where=where, hint=f"known: {', '.join(known)}")


def check_at_least(where: str, value: float, least: float) -> None:
    """For settings. Raises: UsageError unless `value` is finite and at least `least`."""
    if not (math.isfinite(value) and value >= least):
        raise UsageError("setting out of range", where=where, expected=f"at least {least}",
                         found=str(value))  # fmt: skip


def check_above_zero(where: str, value: float) -> None:
    """For settings. Raises: UsageError unless `value` is finite and above 0."""
    if not (math.isfinite(value) and value > 0):
        raise UsageError("setting out of range", where=where, expected="above 0",
                         found=str(value))  # fmt: skip
