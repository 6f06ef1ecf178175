"""Lock states: each locked entry against datasets.yaml and the file in a folder. For `lock`."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from mpdt.data.lock.claim import Claim
from mpdt.data.lock.file import LockEntry, read_lock
from mpdt.data.lock.fingerprint import is_as_locked
from mpdt.data.lock.keeper import spec_claim
from mpdt.data.spec.catalog import Catalog
from mpdt.data.spec.change import changed_keys
from mpdt.data.spec.entry import DatasetSpec
from mpdt.data.spec.smoke import smoke
from mpdt.data.store.reader import open_dataset
from mpdt.errors import MpdtError

SMOKE = "-smoke"


@dataclass(frozen=True)
class LockState:
    """One row of the table.

    Args:
        locked: the locked version, or nothing.
        spec: `same`, `changed`, `raised to 1.1.0`, `not locked`, `not in datasets.yaml`.
        file: `same`, `other episodes`, `other spec`, `damaged`, `cut-out`, or `-` without one.
        problem: what `--check` fails with, and its `hint`; empty where all is well.
    """

    name: str
    locked: str
    spec: str
    file: str
    problem: str = ""
    hint: str = ""


def lock_states(catalog: Catalog, path: Path, folder: Path) -> list[LockState]:
    """Every entry of either file, in the catalog's order, then what only the lock has.

    Raises: FormatError, StorageError for a lock that cannot be read.
    """
    entries = read_lock(path)
    specs = dict(catalog.specs)
    for name in entries:
        origin = name.removesuffix(SMOKE)
        if name not in specs and name != origin and origin in specs:
            specs[name] = smoke(specs[origin])
    names = [*specs, *(name for name in entries if name not in specs)]
    return [_state(name, specs.get(name), entries.get(name), folder) for name in names]


def _state(name: str, spec: DatasetSpec | None, entry: LockEntry | None, folder: Path) -> LockState:
    if entry is None:
        return LockState(name, "", "not locked", "-")
    file, file_problem = _file_state(name, entry, folder / f"{name}.h5")
    is_smoke = name.endswith(SMOKE)
    words = ["mpdt-data", "collect", name.removesuffix(SMOKE), *(["--smoke"] if is_smoke else [])]
    if spec is None:
        return LockState(name, entry.version, "not in datasets.yaml", file)
    try:
        claim = spec_claim(entry, spec)
    except MpdtError as error:
        return LockState(name, entry.version, "changed", file, error.message(), error.hint)
    if claim is not Claim.SAME:
        state, problem = f"raised to {spec.version}", f"{name}: raised to {spec.version}"
        problem += f", but {entry.version} is locked"
        update = ["--update-lock"] if is_smoke else []
        hint = f"{shlex.join([*words, *update])} makes and locks it"
        return LockState(name, entry.version, state, file, problem, hint)
    hint = f"{shlex.join([*words, '--locked', '--restart'])} makes the locked one"
    return LockState(name, entry.version, "same", file, file_problem, hint if file_problem else "")


def _file_state(name: str, entry: LockEntry, path: Path) -> tuple[str, str]:
    """State of the file, and what is wrong with it."""
    if not path.exists():
        return "-", ""
    try:
        data = open_dataset(path)
    except MpdtError as error:
        return "damaged", error.message()
    if data.parent:
        return "cut-out", ""
    if changes := changed_keys(entry.spec, dict(data.spec)):
        return "other spec", f"{path}: made from another spec ({'; '.join(changes)})"
    if not is_as_locked(data, entry):
        hashes = f"content {data.content_hash[:8]}, locked {entry.hashes.content[:8]}"
        return "other episodes", f"{path}: other episodes than locked ({hashes})"
    return "same", ""
