"""Manifest: what a lossless export says about itself, as JSON, and the check when it comes back."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mpdt.data.exchange.incoming import Incoming
from mpdt.data.exchange.selection import Selection
from mpdt.data.spec.entry import canonical_json
from mpdt.data.spec.env import describe_env
from mpdt.data.spec.family import stored_family
from mpdt.data.spec.rules import plain_problems
from mpdt.data.store.sources import EpisodeSource, FileHeader
from mpdt.errors import FormatError, MissingFileError
from mpdt.reading import decode_json

_HASH = "manifest_sha256"
_UNPROVEN = (
    "an export of an older release: its episodes are proven by their content hash; roles, "
    "references, licence and policies are as it says"
)
AGAIN = "take another copy, or export it again"
KEY = "mpdt"
"""Name under which a format keeps the manifest."""


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Header and identity of the episodes in an export.

    As text it carries a hash of itself: roles, references, licence and policies are in no digest,
    and whoever edits them by hand is told so when the export comes back.

    Args:
        content_hash: of a file that has this header and these episodes alone.
        sources: SHA-256 of the ids in the file they were cut out of; "" where there are none.
        is_proven: it came with its hash. Exports of releases before there was one have none.
    """

    header: FileHeader
    content_hash: str
    num_episodes: int
    num_steps: int
    sources: str = ""
    is_proven: bool = True

    @classmethod
    def of(cls, selection: Selection) -> Manifest:
        return cls(
            header=selection.header, content_hash=selection.content_hash,
            num_episodes=len(selection.ids), num_steps=selection.num_steps,
            sources=_hash_of_ids(selection.source_ids),
        )  # fmt: skip

    def to_json(self) -> str:
        """Canonical JSON with its hash; NaN, which JSON does not have, as the text `nan`."""
        said = _without_nan(msgspec.to_builtins(self))
        del said["is_proven"]
        if not said["header"]["definition"]:
            del said["header"]["definition"]  # of a family that mpdt ships
        return canonical_json(said | {_HASH: _hash_of(said)}).decode()

    @classmethod
    def from_json(cls, text: str | bytes, where: str) -> Manifest:
        """Raises: FormatError for anything but a manifest, and for one that was edited."""
        try:
            said = decode_json(text)
            if not isinstance(said, dict):
                raise ValueError("no JSON object")
            hash = said.pop(_HASH, "")
            if hash and hash != _hash_of(said):
                raise ValueError("its hash is that of another manifest")
            manifest = msgspec.convert(said | {"is_proven": bool(hash)}, cls, strict=False)
            _check_numbers(manifest)
            return manifest
        except (ValueError, TypeError, AttributeError) as error:
            raise FormatError("not an export of mpdt, or changed", where=where,
                              found=str(error)[:120],
                              hint=AGAIN) from error  # fmt: skip

    def incoming(self, source: EpisodeSource, remarks: Sequence[str] = ()) -> Incoming:
        """The whole export, to be compared with its content hash once it is written.

        Args:
            remarks: of its format.

        Raises: FormatError for other ids of origin.
        """
        if self.is_proven and _hash_of_ids(source.source_ids) != self.sources:
            raise FormatError("the ids of the file it was cut out of were changed", where=KEY,
                              hint="export it again")  # fmt: skip
        header, tasks = self.header, self.header.tasks
        envs = (
            describe_env(header.spec, header.family, task.name, header.definition) for task in tasks
        )
        ours = [replace(task, env=env) for task, env in zip(tasks, envs, strict=True)]
        told = (*remarks, *(() if self.is_proven else (_UNPROVEN,)))
        return Incoming(replace(header, tasks=ours), source, self.content_hash, told)


def _check_numbers(manifest: Manifest) -> None:
    """Raises: ValueError for a number that no file of ours has room for."""
    header, most = manifest.header, 1 << 31
    if header.definition and plain_problems(stored_family(header.definition)):
        raise ValueError("its definition of the family is none")
    found = [header.observation_size, header.action_size]
    for task in header.tasks:
        found += [task.index, *(one.episodes for one in task.references.by_name.values())]
    for policy in header.policies:
        found += [policy.task, policy.rung, policy.train_step]
    counts = (manifest.num_episodes, manifest.num_steps)
    if wrong := [n for n in found if not -1 <= n < most] + [
        n for n in counts if not 0 <= n < 1 << 53
    ]:
        raise ValueError(f"no file has room for the number {str(wrong[0])[:40]}")


def _hash_of(said: dict[str, Any]) -> str:
    return hashlib.sha256(canonical_json(said)).hexdigest()


def _hash_of_ids(ids: Sequence[int] | None) -> str:
    return "" if ids is None else hashlib.sha256(np.asarray(ids, "<i8").tobytes()).hexdigest()


def single_file(paths: list[Path], what: str, where: str) -> Path:
    """The one file of an export. Raises: MissingFileError, FormatError."""
    if not paths:
        raise MissingFileError(f"no {what} there", where=where,
                               hint="name what mpdt-data export has written")  # fmt: skip
    if len(paths) > 1:
        raise FormatError(f"more than one {what}", where=where, expected="one export",
                          found=f"{paths[0]} and {paths[1]}",
                          hint="import them one by one")  # fmt: skip
    return paths[0]


def _without_nan(value: Any) -> Any:
    if isinstance(value, float) and value != value:
        return "nan"
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return value
