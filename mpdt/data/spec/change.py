"""Change: which keys differ between two documents: specs, plans, headers, configurations."""

from __future__ import annotations

import json
from typing import Any

_ABSENT = object()


def changed_keys(old: Any, new: Any, path: str = "") -> list[str]:
    """`key old -> new` for every leaf that differs between two JSON objects.

    A key that is null is as good as absent: a later release may add one without a value.
    """
    if isinstance(old, dict) and isinstance(new, dict):
        return [
            line
            for key in sorted({*old, *new})
            for line in changed_keys(
                old.get(key, _ABSENT), new.get(key, _ABSENT), f"{path}.{key}" if path else str(key)
            )
        ]
    nothing = (None, _ABSENT)
    if old == new or (old in nothing and new in nothing):
        return []
    before, after = ("absent" if v is _ABSENT else json.dumps(v) for v in (old, new))
    return [f"{path} {before} -> {after}"]
