"""What the command line prints: results of a run, settings of a preset."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from mpdt.draw.table import rich_tables
from mpdt.errors import FormatError, MissingFileError
from mpdt.train.evaluate.score import Score
from mpdt.train.evaluate.tables import build_tables
from mpdt.train.run.config import TrainConfig, to_plain
from mpdt.train.run.folder import RunFolder

WIDTH_WITHOUT_TERMINAL = 160  # columns; tables in a log file are not folded at 80


class RunHeader(msgspec.Struct, frozen=True):
    """What is looked at of results.json beside its scores; other keys may stand there too."""

    data: dict[str, Any] = {}
    config: dict[str, Any] = {}
    backbone: dict[str, Any] = {}
    num_trainables: int = 0
    updates: dict[str, int] = {}
    updates_asked: dict[str, int] = {}
    complete: bool = True


def read_results(folder: Path) -> dict[str, Any]:
    """results.json of a run's folder. Raises: MissingFileError, FormatError."""
    path = folder / "results.json"
    if not path.exists():
        raise MissingFileError(
            "no results here",
            where=str(path),
            hint="a run writes them at its end; the same command continues it",
        )
    try:
        results = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
        msgspec.convert(results, RunHeader)
        scores_in(results)
    except (ValueError, KeyError) as error:
        raise FormatError("not the results of a run", where=str(path), found=str(error)) from error
    return results


def find_results(folder: Path, identity: Mapping[str, str]) -> dict[str, Any] | None:
    """results.json if it is that of a finished run of this identity; damaged ones do not count."""
    try:
        results = read_results(folder)
    except (MissingFileError, FormatError, OSError):
        return None
    same = results.get("identity") == dict(identity) and results.get("complete") is True
    return results if same else None


def set_aside(folder: RunFolder) -> None:
    """Make room for new results: finished ones are kept under judged/, all others go."""
    with suppress(MissingFileError, FormatError):
        results = read_results(folder.path)
        identity = results.get("identity")
        judging = str(identity.get("judging")) if isinstance(identity, dict) else ""
        if re.fullmatch("[0-9a-f]{64}", judging) and results.get("complete") is True:
            kept = folder.judged(judging)
            kept.parent.mkdir(exist_ok=True)
            folder.results.replace(kept)
    folder.results.unlink(missing_ok=True)


def scores_in(results: Mapping[str, Any]) -> list[Score]:
    """The scores of results.json; null is nan again."""
    rows = [
        {
            key: float("nan") if value is None and key != "success" else value
            for key, value in row.items()
        }
        for row in msgspec.convert(results["scores"], list[dict[str, Any]])
    ]
    return msgspec.convert(rows, list[Score])


def print_results(results: Mapping[str, Any], as_json: bool) -> None:
    """Tables on stdout, or the JSON."""
    if as_json:
        sys.stdout.write(json.dumps(results, indent=1) + "\n")
        return
    from rich.console import Console

    if results.get("complete") is False:
        asked = results.get("updates_asked", {})
        done = ", ".join(
            f"{phase} {n} of {asked.get(phase)}" for phase, n in results.get("updates", {}).items()
        )
        sys.stdout.write(f"incomplete, ended by a time limit after updates: {done}\n")
    console = Console(
        file=sys.stdout, width=None if sys.stdout.isatty() else WIDTH_WITHOUT_TERMINAL
    )
    for table in rich_tables(build_tables(scores_in(results))):
        console.print(table)


def settings_text(config: TrainConfig, as_json: bool) -> str:
    """One option per line with its value, or the whole as JSON."""
    plain = to_plain(config)
    if as_json:
        return json.dumps(plain, indent=1) + "\n"
    return "\n".join(_option(key, value) for key, value in _leaves(plain)) + "\n"


def _leaves(plain: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in plain.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _option(key: str, value: Any) -> str:
    """As it is typed: `--prompts.length 30`, `--inputs.no-return-clip`, `--adapt.starts cross`."""
    name = key.replace("_", "-")
    if isinstance(value, bool):
        part, _, last = name.rpartition(".")
        return f"--{name}" if value else f"--{part}.no-{last}"
    words = [str(item) for item in value] if isinstance(value, list | tuple) else [str(value)]
    return " ".join([f"--{name}", *words])
