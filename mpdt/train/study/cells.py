"""The files of a study's cells, as far as reports look into them.

one file     every part has its type; a method of a block has each task once, and the mean
together     one file per (data, label, seed), one content per data set, and for a method of
             a block the same tasks in all files, so that seeds can be put side by side
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from mpdt.errors import FormatError, StorageError
from mpdt.reading import read_json
from mpdt.train.evaluate.score import MEAN, Score
from mpdt.train.evaluate.sealed import check_digest
from mpdt.train.run.results import scores_in

# Both are made parts of paths.
Name = Annotated[str, Meta(pattern=r"\A\w[\w.+-]*\Z")]
Points = Annotated[list[tuple[float, float]], Meta(min_length=1)]
Seen = dict[tuple[object, ...], tuple[Path, Any]]
"""The first file that said something, and what it said."""
_AGAIN = "move it away; its study makes it again"


@dataclass(frozen=True)
class CellResult:
    """One stored result of a study, as tables take it."""

    data: str
    label: str
    seed: int
    scores: tuple[Score, ...]
    content: Mapping[str, Any]


class DataPart(msgspec.Struct, frozen=True):
    name: Name
    content_hash: str


class ConfigPart(msgspec.Struct, frozen=True):
    method: str
    seed: int


class CellFile(msgspec.Struct, frozen=True):
    """What is read of one result; other keys may stand beside."""

    cell: Name
    data: DataPart
    config: ConfigPart
    scores: Annotated[tuple[Score, ...], Meta(min_length=1)]
    curve: dict[str, Points] = {}
    inferred: dict[str, Any] = {}

    @property
    def tasks(self) -> dict[tuple[str, str], list[str]]:
        """(method, block) -> tasks, the mean among them."""
        found: dict[tuple[str, str], list[str]] = {}
        for score in self.scores:
            found.setdefault((score.method, score.block), []).append(score.task)
        return found


def read_cell_files(paths: Iterable[Path]) -> Iterator[tuple[CellFile, dict[str, Any]]]:
    """What is looked at in each file, and all of it.

    Raises: FormatError for a damaged file, or for one that does not go with those before.
    """
    seen: Seen = {}
    for path in paths:
        file, content = _read(path)
        _check_together(path, file, seen)
        yield file, content


def _read(path: Path) -> tuple[CellFile, dict[str, Any]]:
    try:
        content = read_json(path)
        file = msgspec.convert({**content, "scores": scores_in(content)}, CellFile)
    except (StorageError, ValueError, KeyError, RecursionError) as error:
        found = f"no {error.args[0]}" if isinstance(error, KeyError) else str(error)
        raise FormatError("not the result of a cell", where=str(path), found=found,
                          hint=_AGAIN) from error  # fmt: skip
    check_digest(content, str(path), _AGAIN)
    for (method, block), tasks in file.tasks.items():
        twice = sorted({task for task in tasks if tasks.count(task) > 1})
        what = ""
        if twice:
            what = f"has a {block} task twice"
        elif MEAN not in tasks:
            what = f"has no mean over its {block} tasks"
        elif len(tasks) == 1:
            what = f"has no {block} task beside the mean"
        if what:
            raise FormatError(f"{method} {what}", where=str(path), found=", ".join(twice),
                              hint=_AGAIN)  # fmt: skip
    return file, content


def _check_together(path: Path, file: CellFile, seen: Seen) -> None:
    """Raises: FormatError if seeds could not be put side by side with those of earlier files."""
    data, own = file.data, file.config
    earlier, _ = seen.setdefault((data.name, own.method, own.seed), (path, None))
    if earlier != path:
        raise FormatError(f"a second file of {data.name}.{own.method}.s{own.seed}",
                          where=str(path), found=f"also {earlier.name}",
                          hint="move one of them away")  # fmt: skip
    earlier, content_hash = seen.setdefault((data.name,), (path, data.content_hash))
    if content_hash != data.content_hash:
        raise FormatError(f"other episodes of {data.name} than {earlier.name}", where=str(path),
                          expected=content_hash[:12], found=data.content_hash[:12],
                          hint="keep results of one data file in a folder")  # fmt: skip
    for (method, block), tasks in file.tasks.items():
        earlier, others = seen.setdefault((data.name, method, block), (path, tasks))
        if differing := sorted(set(tasks) ^ set(others)):
            raise FormatError(f"other {block} tasks of {method} than {earlier.name}",
                              where=str(path),
                              found=f"in one of them only: {', '.join(differing)}",
                              hint="move away the damaged one; its study makes it")  # fmt: skip
