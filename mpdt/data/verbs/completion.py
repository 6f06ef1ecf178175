"""Scripts that make a shell complete the verbs and options of a program; tyro writes them."""

from __future__ import annotations

import io
from collections.abc import Mapping
from contextlib import redirect_stdout, suppress
from typing import Annotated, Any, Literal, Union

import tyro
from tyro.conf import Positional, arg, subcommand

Shell = Annotated[Positional[Literal["bash", "zsh", "fish"]], arg(metavar="bash|zsh|fish")]


def completion_script(
    prog: str, commands: Mapping[str, type], shell: str, config: tuple[Any, ...] = ()
) -> str:
    """Of all commands as they are today.

    Args:
        config: tyro's configuration of that program.
    """
    choices = [
        Annotated[command, subcommand(name, description=first_line(command))]
        for name, command in commands.items()
    ]
    printed = io.StringIO()
    words = ["--tyro-print-completion", shell]
    with redirect_stdout(printed), suppress(SystemExit):
        verbs: Any = Union[tuple(choices)]  # noqa: UP007  built at run time
        tyro.cli(verbs, args=words, prog=prog, config=config)
    return printed.getvalue()


def verb_lines(commands: Mapping[str, type]) -> list[str]:
    """Every verb with the first line of its docstring, for the help of a program."""
    width = max(map(len, commands)) + 2
    return [f"  {name:<{width}}{first_line(command)}" for name, command in commands.items()]


def first_line(command: type) -> str:
    """Of its docstring: what it does."""
    return (command.__doc__ or "").partition("\n")[0]
