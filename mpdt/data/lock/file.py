"""datasets.lock: what each entry of datasets.yaml gave when it was collected.

    datasets.yaml   what to make         written by people
    datasets.lock   what came out        written by `mpdt-data collect`, committed with it

Whoever has both can make the data again and knows whether they got the same. The lock keeps the
spec itself, so that a change can be named, and one hash per run of episodes, so that "the old
episodes are all still there" can be checked without the old file:

    runs: {forward: {random: 200 9f31c0de5a7b1e22, history-07: 20 1c40...}}

A run is the episodes of one task and one quality (in `history`: one rung too) in their order; the
number is how many, the hash covers their digests. More episodes only ever append to a run.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from mpdt.data.spec.entry import (
    Problem,
    SpecMistakesError,
    canonical_json,
    raise_problems,
    spec_hash,
)
from mpdt.data.spec.strict import build
from mpdt.data.spec.tasks import find_family
from mpdt.data.spec.yamltext import dump_yaml, load_yaml
from mpdt.errors import FormatError, MissingFileError, SpecError
from mpdt.reading import read_plain

FILE_NAME = "datasets.lock"
SCHEMA = 1
_HEADING = (
    "# What datasets.yaml gave. Written by mpdt-data collect; commit it, do not edit it.\n"
    "# mpdt-data lock --check compares; mpdt-data collect NAME --locked makes the same again.\n"
)
_HASH, _RUN = re.compile(r"[0-9a-f]{64}"), re.compile(r"[1-9][0-9]* [0-9a-f]{16}")


class Hashes(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """SHA-256 in hex. `file` is that of the file's bytes, for transport only."""

    spec: str
    content: str
    file: str
    tta: dict[str, str] = {}


class Size(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    bytes: int
    episodes: int
    steps: int


class LockEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One data set as it was collected.

    Args:
        spec: the entry of datasets.yaml as plain values, defaults filled in.
        runs: task -> run -> `number hash`; see the top of this file.
        policies: task -> name -> first 16 hex digits of the hash of every policy that acted.
        returns: task -> quality -> mean return.
        tables: task -> first 16 hex digits over its role, references and policies; none in an
            entry that an older release wrote.
    """

    version: str
    hashes: Hashes
    size: Size
    spec: dict[str, Any]
    runs: dict[str, dict[str, str]]
    policies: dict[str, dict[str, str]]
    returns: dict[str, dict[str, float]]
    packages: dict[str, str]
    platform: dict[str, str]
    tables: dict[str, str] = {}


def decisive_packages(family: str) -> tuple[str, ...]:
    """Packages whose version may change the numbers of an episode.

    The others write the numbers down; that mpdt itself keeps them is what the lock is for.
    """
    known = find_family(family)
    own = ("metaworld", "mujoco") if known is None else known.packages
    return ("gymnasium", *own, "numpy")


def run_text(digests: bytes) -> str:
    """A run as the lock keeps it: how many 32-byte digests, and a short hash over them."""
    return f"{len(digests) // 32} {hashlib.sha256(digests).hexdigest()[:16]}"


def lock_path(catalog: Path) -> Path:
    """Where the lock of a datasets.yaml is: beside it, where its user may write.

    The datasets.yaml that comes inside the installed package, and one in a folder that cannot be
    written, have theirs in the working folder.
    """
    installed = catalog.resolve().parent == Path(__file__).resolve().parents[2]
    if installed or not os.access(catalog.parent, os.W_OK):
        return Path(FILE_NAME)
    return catalog.with_name(FILE_NAME)


def read_lock(path: Path) -> dict[str, LockEntry]:
    """The entries by name; none where there is no file.

    Raises: FormatError for anything `lock_bytes` would not have written; StorageError.
    """
    try:
        text = read_plain(path).decode("utf-8")
    except MissingFileError:
        return {}
    except UnicodeDecodeError as error:
        raise _damaged(path, SpecError("not UTF-8 text")) from error
    try:
        return parse_lock(text, str(path))
    except SpecError as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: SpecError) -> FormatError:
    return FormatError(
        error.what,
        where=error.where or str(path),
        expected=error.expected,
        found=error.found,
        hint=f"take it from version control, or move it away: collect writes a new {FILE_NAME}",
    )


def parse_lock(text: str, where: str) -> dict[str, LockEntry]:
    """The entries of a lock's text. Raises: SpecError listing every mistake."""
    document = load_yaml(text, where)
    if not isinstance(document, dict) or set(document) != {"schema", "datasets"}:
        raise SpecError("expected the keys schema and datasets", where=where)
    if document["schema"] != SCHEMA or isinstance(document["schema"], bool):
        raise SpecError("another schema needs another release of mpdt", where=where,
                        expected=str(SCHEMA), found=repr(document["schema"]))  # fmt: skip
    if not isinstance(document["datasets"], dict):
        raise SpecError("datasets: expected a block of entries", where=where)
    problems: list[Problem] = []
    entries: dict[str, LockEntry] = {}
    for name, value in document["datasets"].items():
        try:
            entry = build(LockEntry, value, str(name), problems)
        except SpecMistakesError as error:  # pragma: no cover - entries have no checks of their own
            problems += error.problems
            continue
        if entry is not None:
            entries[str(name)] = entry
            problems += _entry_problems(str(name), entry)
    raise_problems(problems, where, separator=": ")
    return entries


def _entry_problems(name: str, entry: LockEntry) -> list[Problem]:
    hashes = entry.hashes
    named = {"spec": hashes.spec, "content": hashes.content, "file": hashes.file}
    named |= {f"tta.{key}": value for key, value in hashes.tta.items()}
    problems = [
        (f"{name}.hashes.{key}", "not 64 hex digits", "")
        for key, value in named.items()
        if not _HASH.fullmatch(value)
    ]
    problems += [
        (f"{name}.runs.{task}.{run}", f"{value!r} is not a number and 16 hex digits", "")
        for task, runs in entry.runs.items()
        for run, value in runs.items()
        if not _RUN.fullmatch(value)
    ]
    try:
        found = spec_hash(entry.spec)
    except (TypeError, ValueError):  # keys that are no text, or a number that is none
        found = ""
    said = (entry.spec.get("name"), entry.spec.get("version"))
    if found != hashes.spec or said != (name, entry.version):
        problems.append((f"{name}.spec", "does not have its hash: edited by hand", ""))
    return problems


def lock_bytes(entries: Mapping[str, LockEntry]) -> bytes:
    """The file for these entries: one byte form, whatever their order."""
    plain = {name: msgspec.to_builtins(entry) for name, entry in entries.items()}
    for entry in plain.values():
        if not entry["tables"]:  # the entry of an older release stays what it was
            del entry["tables"]
    # A round trip, so that tuples are lists and nothing but JSON values is left.
    document = json.loads(canonical_json({"schema": SCHEMA, "datasets": plain}))
    return (_HEADING + dump_yaml(document)).encode("utf-8")
