"""LockKeeper: what datasets.lock has to say before, during and after a collection.

    before    the spec changed but its version did not       refused, nothing is simulated
    during    the episodes are known, the file is not yet    a false claim, or --locked and
              in its place                                    other content: nothing is replaced
    after     the file is there                              a new entry, or a warning

A version that was raised is its user's consent: if what it claims holds, the entry is replaced.
Under the same version only `update` replaces one.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from mpdt.data.lock.claim import Claim, claim_of, next_version
from mpdt.data.lock.file import LockEntry, decisive_packages, lock_bytes, read_lock
from mpdt.data.lock.fingerprint import fingerprint, is_as_locked, lost_runs, other_versions
from mpdt.data.spec.change import changed_keys
from mpdt.data.spec.entry import DatasetSpec, canonical_json, spec_hash
from mpdt.data.store import provenance
from mpdt.data.store.dataset import Dataset
from mpdt.disk import holding, write_bytes
from mpdt.errors import DataError, SimulatorError, quoted

MACHINE = ("arch", "cpu", "blas")


def plain_spec(spec: DatasetSpec) -> dict[str, Any]:
    """The spec as the JSON values that files and locks hold."""
    plain: dict[str, Any] = msgspec.json.decode(canonical_json(spec))
    return plain


def spec_claim(entry: LockEntry, spec: DatasetSpec) -> Claim:
    """What the spec's version claims against the locked one; SAME if the spec did not change.

    Raises: DataError if the spec changed and its version was not raised.
    """
    new = plain_spec(spec)
    changes = changed_keys(entry.spec, new)
    if not changes:
        return Claim.SAME
    claim = claim_of(entry.version, spec.version)
    name, others = spec.name, [line for line in changes if not line.startswith("version ")]
    hashes = {"expected": f"spec {entry.hashes.spec}", "found": f"spec {spec_hash(spec)}"}
    if claim is Claim.SAME:
        version = next_version(entry.version, entry.spec, new)
        raise DataError(
            f"the spec changed ({'; '.join(others or changes)}) but version is still "
            f"{spec.version}",
            where=name,
            hint=f'set version "{version}", then run: mpdt-data collect {quoted(name)}',
            **hashes,
        )
    if claim is Claim.BACK:
        raise DataError(
            f"the spec changed ({'; '.join(changes)}) and its version went back",
            where=name,
            hint=f"set a version above {entry.version}",
            **hashes,
        )
    return claim


def check_claim(claim: Claim, entry: LockEntry, dataset: Dataset) -> None:
    """Does the data keep what its raised version says about the locked version?

    Raises: DataError naming the runs that are not what they were.
    """
    lost = lost_runs(dataset, entry)
    same = is_as_locked(dataset, entry)
    if claim is Claim.MAJOR or (claim is Claim.MINOR and not lost) or same:
        return
    promise = "the same data" if claim is Claim.PATCH else "every old episode as it was"
    found = f"changed or missing: {_some(lost)}" if lost else "other episodes were added"
    major, minor, _ = entry.version.split(".", 2)
    honest = f"{int(major) + 1}.0.0" if lost else f"{major}.{int(minor) + 1}.0"
    raise DataError(
        f"{entry.version} -> {dataset.version} claims a {claim.value} change",
        where=dataset.name,
        expected=promise,
        found=found,
        hint=f'set version "{honest}" and collect again: finished blocks are kept',
    )


@dataclass(frozen=True)
class LockKeeper:
    """The lock file of one collection.

    Args:
        locked: nothing but the locked content will do.
        update: replace the entry even if the version is the same.
        add: write an entry where there is none (not for smoke versions).
    """

    path: Path
    locked: bool = False
    update: bool = False
    add: bool = True

    def before(self, spec: DatasetSpec) -> None:
        """Raises: DataError as `spec_claim`, or with `locked` if the lock holds no such spec;
        SimulatorError with `locked` if other packages are installed; FormatError, StorageError.
        """
        entry = self.entry(spec.name)
        claim = spec_claim(entry, spec) if entry else Claim.SAME
        if not self.locked:
            return
        if entry is None:
            raise DataError(
                "not in the lock",
                where=str(self.path),
                found=spec.name,
                hint=f"mpdt-data collect {quoted(spec.name)} without --locked adds it",
            )
        if claim is not Claim.SAME:
            raise DataError(
                "another version than the locked one",
                where=spec.name,
                expected=entry.version,
                found=spec.version,
                hint=f"mpdt-data collect {quoted(spec.name)} without --locked makes and locks it",
            )
        names = decisive_packages(spec.family)
        if other := other_versions(entry.packages, provenance.packages(), names):
            pins = " ".join(f"{n}=={entry.packages[n]}" for n in names if n in entry.packages)
            raise SimulatorError(
                f"other versions than locked: {other}",
                where=spec.name,
                hint=f"pip install {pins}; or leave out --locked, for a warning instead",
            )

    def approve(self, dataset: Dataset) -> None:
        """Look at all episodes before the file takes its place.

        Raises: DataError if they are not the locked ones under `locked`, or not what a raised
            version claims.
        """
        entry = self.entry(dataset.name)
        if entry is None:
            return
        if changed_keys(entry.spec, dict(dataset.spec)):
            check_claim(claim_of(entry.version, dataset.version), entry, dataset)
        elif self.locked and (other := _difference(entry, dataset)):
            raise DataError(
                "other episodes than locked",
                where=dataset.name,
                expected=f"content {entry.hashes.content[:8]}",
                found=f"{dataset.content_hash[:8]}; {other}",
                hint="compare the versions and the machine with the lock: mpdt-data lock",
            )

    def after(self, dataset: Dataset) -> tuple[str, list[str]]:
        """Write what is new, and say what happened: a line for the user, and warnings.

        Raises: StorageError, FormatError.
        """
        entry = self.entry(dataset.name)
        what = f"{dataset.name} {dataset.version}"
        if entry is None:
            if not (self.add or self.update):
                return "", []
            self._write(dataset)
            return f"{self.path}: {what} added", []
        if changed_keys(entry.spec, dict(dataset.spec)):
            self._write(dataset)
            claim = claim_of(entry.version, dataset.version).value
            return f"{self.path}: {entry.version} -> {what} ({claim})", []
        warnings = []
        names = decisive_packages(dataset.family)
        if other := other_versions(entry.packages, dataset.packages, names):
            warnings.append(f"{what} was locked with other versions: {other}")
        if difference := _difference(entry, dataset):
            machine = other_versions(entry.platform, dataset.platform, MACHINE)
            because = f" ({machine})" if machine and not other else ""
            warnings.append(f"{what} is not what {self.path} holds: {difference}{because}")
        if self.update:
            self._write(dataset)
            return f"{self.path}: {what} updated", warnings
        if warnings:
            warnings[-1] += "; --update-lock replaces the entry"
            return "", warnings
        return f"{self.path}: {what} as locked", []

    def entry(self, name: str) -> LockEntry | None:
        """What the lock holds of `name`. Raises: FormatError, StorageError."""
        return read_lock(self.path).get(name)

    def _write(self, dataset: Dataset) -> None:
        entry = fingerprint(dataset)
        with holding(self.path, amends=True):
            entries = read_lock(self.path) | {dataset.name: entry}
            write_bytes(self.path, lock_bytes(entries))


def _difference(entry: LockEntry, dataset: Dataset) -> str:
    """How the data differs from its entry, or nothing."""
    if is_as_locked(dataset, entry):
        return ""
    return f"other episodes in {_some(lost_runs(dataset, entry)) or 'added runs'}"


def _some(runs: list[str]) -> str:
    more = f" and {len(runs) - 3} more" if len(runs) > 3 else ""
    return ", ".join(runs[:3]) + more
