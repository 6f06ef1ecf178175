"""A digest over results: whoever edits them by hand is told so when they are read.

Results from before there were digests (`mpdt-results/1`) carry none and are read as they are.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from mpdt.errors import FormatError

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


def _digest(content: Mapping[str, Any]) -> str:
    # A round trip, so that what was computed and what was read are the same values.
    text = json.dumps(json.loads(json.dumps(content)), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode("ascii")).hexdigest()
