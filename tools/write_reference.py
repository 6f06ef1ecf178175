"""Write docs/reference/cli.md and api.md, and tests/golden/options.txt, from the code.

    make docs

`tests/tools/test_references.py` fails when one of them is older than the code. options.txt is the
frozen list of all that the two programs take: a change of it is one for whoever scripts them.
"""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import re
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import tyro

ROOT = Path(__file__).parent.parent
COMMON = ("--json", "--quiet", "--verbose", "--color")
WRITTEN = "Written by `make docs`; do not edit."


def main() -> None:
    for path, text in pages().items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        sys.stdout.write(f"wrote  {path.relative_to(ROOT)}\n")


def pages() -> dict[Path, str]:
    """Every generated file and what it should hold."""
    return {
        ROOT / "docs/reference/cli.md": cli_page(),
        ROOT / "docs/reference/api.md": api_page(),
        ROOT / "tests/golden/options.txt": option_list(),
    }


# ---- the command lines ----


def commands() -> Iterator[tuple[str, type, tuple[Any, ...]]]:
    """What is typed, the dataclass that takes it, and tyro's configuration of that program."""
    from mpdt.data.cli import CONFIG, VERBS
    from mpdt.train.options import COMMANDS

    for name, verb in VERBS.items():
        yield f"mpdt-data {name}", verb, CONFIG
    for name, command in COMMANDS.items():
        yield ("mpdt-train" if name == "run" else f"mpdt-train {name}"), command, ()


class Option(NamedTuple):
    """One option or positional word: as typed, default, help."""

    words: str
    default: str
    help: str


def options(command: type, config: tuple[Any, ...]) -> list[Option]:
    """In the order of the help, positional words first."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # nothing takes its place
        parser = tyro.extras.get_parser(command, config=config)
    found = [_option(action) for action in parser._actions if action.dest != "help"]
    return sorted(found, key=lambda one: one.words.startswith("-"))


def _option(action: argparse.Action) -> Option:
    flags = ", ".join(sorted(action.option_strings, key=lambda word: (len(word) < 3, word)))
    metavar = action.metavar if isinstance(action.metavar, str) else ""
    help, _, default = (action.help or "").rpartition("(")
    default = default.removesuffix(")")
    if not default.startswith(("default", "required", "optional")):
        help, default = f"{help}({default}" if help else default, ""
    default = "" if default.strip() == "default:" else default
    return Option(f"{flags} {metavar}".strip(), default, " ".join(help.split()))


def option_list() -> str:
    """One line per verb and option: the words and the default."""
    lines = []
    for name, command, config in commands():
        lines.append(name)
        lines += [f"    {one.words:<40} {one.default}".rstrip() for one in options(command, config)]
    return "\n".join(lines) + "\n"


def cli_page() -> str:
    from mpdt.draw.table import markdown_table

    parts = [f"# Command lines\n\n{WRITTEN} `-h` prints the same.\n\n"
             f"Every verb of mpdt-data takes {', '.join(f'`{word}`' for word in COMMON)} too: one "
             "JSON document on stdout, nothing on stderr, tracebacks, colour `auto` or `never`. "
             "Results go to stdout, progress and remarks to stderr. Exit codes: 0 done or nothing "
             "to do, 1 data wrong or disk refused, 2 usage, 3 simulator, 4 somebody else is at "
             "it, 130 Ctrl-C, 143 SIGTERM.\n"]  # fmt: skip
    for name, command, config in commands():
        text = inspect.cleandoc(command.__doc__ or "")
        about, _, examples = text.partition("Examples:\n")
        parts.append(f"\n## {name}\n\n{about.strip()}\n")
        if examples:
            parts.append(f"\n```\n{inspect.cleandoc(examples)}\n```\n")
        rows = [one for one in options(command, config)
                if not (config and any(word in one.words for word in COMMON))]  # fmt: skip
        if rows:
            cells = [(f"`{one.words}`", one.help, one.default) for one in rows]
            parts.append("\n" + markdown_table(("", "", ""), cells, numbers=False) + "\n")
    return "".join(parts)


# ---- the Python interface ----


def api_page() -> str:
    """The functions of `mpdt`, what they return, and the errors."""
    import mpdt
    import mpdt.errors
    from mpdt.data.episode import Episode
    from mpdt.data.slices.sampler import WindowSampler
    from mpdt.data.slices.windows import WindowBatch
    from mpdt.data.store.dataset import Dataset
    from mpdt.train.bundle.acting import ActingPolicy

    parts = [f"# Python interface\n\n{WRITTEN}\n\n"
             "```python\nimport mpdt\n```\n\nFour functions, and what they return. Everything else "
             "may move between releases; `docs/architecture.md` says where it is.\n"]  # fmt: skip
    for name in mpdt._HOMES:
        parts.append(_function(f"mpdt.{name}", getattr(mpdt, name), "##"))
    for kind in (Dataset, Episode, WindowSampler, WindowBatch, ActingPolicy):
        parts.append(_class(kind))
    parts.append(f"\n## Errors\n\n```\n{inspect.getdoc(mpdt.errors)}\n```\n")
    import mpdt.envs

    parts.append(f"\n## Gymnasium ids\n\n```\n{inspect.getdoc(mpdt.envs)}\n```\n")
    return "".join(parts)


def _class(kind: type) -> str:
    text = f"\n## {kind.__module__}.{kind.__name__}\n\n```\n{inspect.getdoc(kind) or ''}\n```\n"
    if dataclasses.is_dataclass(kind):
        fields = ", ".join(f"`{field.name}`" for field in dataclasses.fields(kind))
        text += f"\nFields: {fields}.\n"
    for name, member in vars(kind).items():
        if name.startswith("_"):
            continue
        if isinstance(member, property) and member.fget is not None:
            text += f"\n`{name}` -> `{_returns(member.fget)}`" + _sentence(member) + "\n"
        elif inspect.isfunction(member):
            text += _function(name, member, "###")
    return text


def _function(name: str, function: Callable[..., Any], level: str) -> str:
    signature = re.sub(r"'([^']*)'", r"\1", str(inspect.signature(function)))
    doc = inspect.getdoc(function) or ""
    short = name.rpartition(".")[2]
    block = f"{short}{signature}" + (f"\n\n{doc}" if doc else "")
    return f"\n{level} {name}\n\n```\n{block}\n```\n"


def _returns(function: Callable[..., Any]) -> str:
    return str(inspect.signature(function).return_annotation).strip("'")


def _sentence(member: property) -> str:
    doc = inspect.getdoc(member)
    return f": {doc}" if doc else ""


if __name__ == "__main__":
    main()
