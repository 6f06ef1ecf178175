"""Argument: what was typed, looked at before `Path` forgets how. Nothing heavy: help imports it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import get_type_hints

from mpdt.errors import UsageError

_WRITTEN = {"output", "html", "png", "mp4", "markdown", "keep", "board"}


def refuse_folder_names(words: Sequence[str], command: type) -> None:
    """A slash at the end of what is to be a file; `Path` drops it and a file would lie there.

    Args:
        words: as typed behind the command.
        command: its options; those of `_WRITTEN` are a file's, unless they say FOLDER or PATH.

    Raises: UsageError.
    """
    hints = get_type_hints(command, include_extras=True)
    known = [(name, one) for name in hints for one in getattr(hints[name], "__metadata__", ())]
    files = {
        option for name, one in known
        if name in _WRITTEN and getattr(one, "metavar", None) in ("FILE", "HTML")
        for option in (f"--{name.replace('_', '-')}", *(one.aliases or ()))
    }  # fmt: skip
    pairs = [*pairwise(words), *(tuple(word.split("=", 1)) for word in words if "=" in word)]
    pairs += [(word[:2], word[2:]) for word in words if not word.startswith("--")]
    for option, value in pairs:
        if option in files and value.endswith(("/", "/.")):
            raise UsageError(
                "the name of a folder, and a file is to be written",
                where=f"{option} {value}",
                hint="put the file's name behind it",
            )
