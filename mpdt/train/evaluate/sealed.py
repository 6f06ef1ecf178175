"""A digest over results: whoever edits them by hand is told so when they are read.

Results from before there were digests (`mpdt-results/1`) carry none and are read as they are.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from mpdt.errors import FormatError
from mpdt.reading import read_plain

KEY = "digest"
FORMAT = "mpdt-results/2"
_WITHOUT = "mpdt-results/1"


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """`content` with its digest, in place of an older one."""
    own = {key: value for key, value in content.items() if key != KEY}
    return {**own, KEY: _digest(own)}


def check_digest(content: Mapping[str, Any], where: str, hint: str) -> None:
    """Raises: FormatError for content that is not what was written."""
    said = content.get(KEY)
    if said is None and content.get("format", _WITHOUT) == _WITHOUT:
        return
    own = {key: value for key, value in content.items() if key != KEY}
    if said != (found := _digest(own)):
        raise FormatError("changed after it was written", where=where,
                          expected=f"digest {str(said)[:12]}" if said else "a digest",
                          found=found[:12], hint=hint)  # fmt: skip


def read_json(path: Path) -> dict[str, Any]:
    """The object in a file of JSON.

    Raises: MissingFileError; FormatError for anything else; StorageError.
    """
    content = read_plain(path)
    try:
        return msgspec.json.decode(content, type=dict[str, Any])
    except (ValueError, RecursionError) as error:
        raise FormatError("not a JSON object", where=str(path),
                          found=str(error)[:120]) from error  # fmt: skip


def _digest(content: Mapping[str, Any]) -> str:
    # A round trip, so that what was computed and what was read are the same values.
    text = json.dumps(json.loads(json.dumps(content)), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode("ascii")).hexdigest()
