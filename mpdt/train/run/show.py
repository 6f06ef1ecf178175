"""What the command line prints: results of a run, settings of a preset."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from mpdt.draw.table import rich_tables
from mpdt.errors import quoted
from mpdt.pipe import table_console
from mpdt.train.evaluate.tables import build_tables
from mpdt.train.run.config import TrainConfig, to_plain
from mpdt.train.run.methods import METHODS, apply_method
from mpdt.train.run.presets import PRESETS, get_preset
from mpdt.train.run.results import scores_in


def print_results(results: Mapping[str, Any], as_json: bool) -> None:
    """Tables on stdout, or the JSON."""
    if as_json:
        sys.stdout.write(json.dumps(results, indent=1) + "\n")
        return
    if results.get("complete") is False:
        asked = results.get("updates_asked", {})
        done = ", ".join(
            f"{phase} {n} of {asked.get(phase)}" for phase, n in results.get("updates", {}).items()
        )
        sys.stdout.write(f"incomplete, ended by a time limit after updates: {done}\n")
    console = table_console()
    for table in rich_tables(build_tables(scores_in(results), "policy" not in results)):
        console.print(table)


def what_next(folder: Path) -> str:
    """What to do with a finished run, for whoever made the first one."""
    page, made = f"{folder.name}.html", f"{folder.name}-policy.h5"
    return (
        f"policy  {folder / 'policy'}   in Python: mpdt.load_policy({str(folder)!r}, task=NAME)\n"
        f"next    mpdt-train report {quoted(folder)} --html {quoted(page)}\n"
        f"        mpdt-train rollout {quoted(folder)} -o {quoted(made)}"
    )


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


def command_text(config: TrainConfig, data: str) -> str:
    """The shortest `mpdt-train --data ...` whose settings are these."""
    texts = []
    for preset in PRESETS:
        words = ["mpdt-train", "--data", data]
        base = get_preset(preset)
        if preset != "base":
            words += ["--preset", preset]
        if config.method in METHODS and config.method != base.method:
            words += ["--method", config.method]
            base = apply_method(base, config.method)
        before = dict(_leaves(to_plain(base)))
        words += [_option(key, value) for key, value in _leaves(to_plain(config))
                  if before[key] != value]  # fmt: skip
        texts.append(" ".join(words))
    return min(texts, key=len)
