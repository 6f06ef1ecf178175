"""Catalog: the entries of a datasets.yaml, read strictly, all mistakes at once."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from mpdt.data.spec.entry import (
    Behaviour,
    DatasetSpec,
    EpisodeCounts,
    Problem,
    SpecMistakesError,
    raise_problems,
)
from mpdt.data.spec.own import FILE_NAME, declared_family
from mpdt.data.spec.strict import collect
from mpdt.data.spec.yamltext import load_yaml
from mpdt.errors import MissingFileError, SpecError, StorageError, nearest, unknown_name
from mpdt.reading import read_plain

__all__ = ["Catalog", "load_catalog", "shipped_catalog"]

SCHEMA = 1
_TOP_KEYS = ("schema", "families", "datasets")


@dataclass(frozen=True)
class Catalog:
    """Entries by name, in the order of the file."""

    path: Path
    specs: dict[str, DatasetSpec]

    def get(self, name: str) -> DatasetSpec:
        """Raises: UsageError naming the nearest entry."""
        if name not in self.specs:
            raise unknown_name("dataset", name, self.specs, where=str(self.path))
        return self.specs[name]


def load_catalog(path: Path | None = None) -> Catalog:
    """Read a datasets.yaml.

    Args:
        path: None = the one in the working folder if there is one, else the shipped one.
    Raises: MissingFileError; StorageError; SpecError listing every mistake with its full key.
    """
    chosen = _default_path() if path is None else Path(path)
    if chosen.is_dir():
        raise StorageError("a folder, not a file", where=str(chosen),
                           hint="rename it, or name another file with --spec")  # fmt: skip
    try:
        text = read_plain(chosen).decode("utf-8")
    except MissingFileError as error:
        raise MissingFileError(error.what, where=str(chosen), found=error.found,
                               hint=f"name an existing {FILE_NAME}, or leave the option out for "
                                    "the shipped one") from error  # fmt: skip
    except UnicodeDecodeError as error:
        raise SpecError("not UTF-8 text", where=str(chosen), found=str(error)) from error
    return Catalog(chosen, dict(_parsed(text, str(chosen))))


def shipped_catalog() -> Catalog:
    """The datasets.yaml that mpdt comes with, whatever lies in the working folder.

    Raises: as `load_catalog`.
    """
    return load_catalog(_shipped_path())


def _default_path() -> Path:
    here = Path(FILE_NAME)
    # Also a folder or a broken link: to pass it over would surprise.
    return here if os.path.lexists(here) else _shipped_path()


def _shipped_path() -> Path:
    # Wheels carry the file inside the package; an editable install has it beside the package.
    package = Path(__file__).parents[2]
    inside = package / FILE_NAME
    return inside if inside.is_file() else package.parent / FILE_NAME


# Hints of errors ask which entries there are, and reading the shipped file takes 40 ms.
@lru_cache(maxsize=4)
def _parsed(text: str, where: str) -> dict[str, DatasetSpec]:
    return parse_catalog(text, where)


def parse_catalog(text: str, where: str) -> dict[str, DatasetSpec]:
    """The entries of YAML text.

    Raises: SpecError listing every mistake with its full key.
    """
    document = load_yaml(text, where)
    if not isinstance(document, dict):
        raise SpecError("expected the keys schema and datasets", where=where)
    problems: list[Problem] = []
    for key in document:
        if key not in _TOP_KEYS:
            what = f"unknown key '{key}' {nearest(str(key), _TOP_KEYS)}".rstrip()
            problems.append(("", what, f"allowed: {', '.join(_TOP_KEYS)}"))
    if document.get("schema") != SCHEMA or isinstance(document.get("schema"), bool):
        found = document.get("schema")
        problems.append(("schema", f"expected {SCHEMA}, found {found!r}",
                         "another schema needs another release of mpdt"))  # fmt: skip
    _register(document.get("families", {}), where, problems)
    entries = document.get("datasets")
    if not isinstance(entries, dict):
        problems.append(("datasets", "expected a block of entries", ""))
        entries = {}
    specs: dict[str, DatasetSpec] = {}
    for name, entry in entries.items():
        spec = _entry(str(name), entry, problems)
        if spec is not None:
            specs[spec.name] = spec
    raise_problems(problems, where, separator=": ")
    return specs


def _register(families: object, where: str, problems: list[Problem]) -> None:
    """One's own families, before the entries that name them."""
    if not isinstance(families, dict):
        problems.append(("families", "expected a block of families", ""))
        return
    for name, entry in families.items():
        try:
            declared_family(str(name), entry, str(Path(where).absolute().parent))
        except SpecError as error:
            problems.append((f"families.{name}", error.message(), error.hint))


def _entry(name: str, entry: object, problems: list[Problem]) -> DatasetSpec | None:
    found: list[Problem] = []
    spec: DatasetSpec | None = None
    if isinstance(entry, dict) and "name" in entry:
        found.append(("", "unknown key 'name'", "the entry's own key is its name"))
    named = {**entry, "name": name} if isinstance(entry, dict) else entry
    fields = collect(DatasetSpec, named, "", found)
    if "family" not in fields:  # tasks and options cannot be judged without it
        fields = {key: value for key, value in fields.items() if key not in ("tasks", "env")}
    try:
        # With stand-ins for what is wrong or missing, so that the rest is still looked at.
        spec = DatasetSpec(**((_STAND_INS if found else {}) | fields))
    except SpecMistakesError as error:
        found += error.problems
    if f"families.{fields.get('family')}" in (key for key, _, _ in problems):
        found = [one for one in found if one[0] != "family"]  # told once for all its entries
    problems += [(f"{name}.{key}" if key else name, what, hint) for key, what, hint in found]
    return spec


_STAND_INS: dict[str, Any] = {
    "name": "x", "version": "0.0.0", "family": "cheetah_dir", "horizon": 1, "seed": 0, "block": 1,
    "behaviour": Behaviour(network="x"), "episodes": EpisodeCounts(), "license": "x",
}  # fmt: skip
