"""Results of a study -> tables and plots."""

from pathlib import Path


def is_study(folder: Path) -> bool:
    return False


def print_study(folder: Path, output: Path | None, as_json: bool) -> None:
    raise NotImplementedError
