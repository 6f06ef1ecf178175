"""Manifest: what a lossless export says about itself, as JSON, and the check when it comes back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from mpdt.data.exchange.incoming import Incoming
from mpdt.data.exchange.selection import Selection
from mpdt.data.spec.entry import canonical_json
from mpdt.data.store.sources import EpisodeSource, FileHeader
from mpdt.errors import FormatError, MissingFileError
from mpdt.reading import decode_json

KEY = "mpdt"
"""Name under which a format keeps the manifest."""


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Header and identity of the episodes in an export.

    Args:
        content_hash: of a file that has this header and these episodes alone.
    """

    header: FileHeader
    content_hash: str
    num_episodes: int
    num_steps: int

    @classmethod
    def of(cls, selection: Selection) -> Manifest:
        return cls(
            header=selection.header, content_hash=selection.content_hash,
            num_episodes=len(selection.ids), num_steps=selection.num_steps,
        )  # fmt: skip

    def to_json(self) -> str:
        """Canonical JSON; NaN, which JSON does not have, as the text `nan`."""
        return canonical_json(_without_nan(msgspec.to_builtins(self))).decode()

    @classmethod
    def from_json(cls, text: str | bytes, where: str) -> Manifest:
        """Raises: FormatError for anything but a manifest."""
        try:
            return msgspec.convert(decode_json(text), cls, strict=False)
        except ValueError as error:
            raise FormatError("not an export of mpdt, or changed", where=where,
                              found=str(error)[:120],
                              hint="export it again, or name its --family to import it as "
                                   "foreign data") from error  # fmt: skip

    def incoming(self, source: EpisodeSource) -> Incoming:
        """The whole export, to be compared with its content hash once it is written."""
        return Incoming(self.header, source, self.content_hash)


def single_file(paths: list[Path], what: str, where: str) -> Path:
    """The one file of an export. Raises: MissingFileError, FormatError."""
    if not paths:
        raise MissingFileError(f"no {what} there", where=where)
    if len(paths) > 1:
        raise FormatError(f"several times {what}", where=where, expected="one export",
                          found=f"{paths[0]} and {paths[1]}")  # fmt: skip
    return paths[0]


def _without_nan(value: Any) -> Any:
    if isinstance(value, float) and value != value:
        return "nan"
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return value
