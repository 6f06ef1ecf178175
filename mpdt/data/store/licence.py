"""The licence of data from several sources: what any of them asks for, all of it holds."""

from __future__ import annotations

from collections.abc import Iterable

UNKNOWN = "NOASSERTION"
"""SPDX's word for a licence that nobody has named."""


def combined(licences: Iterable[str]) -> str:
    """One SPDX expression, each licence once: MIT and CC-BY-NC-4.0 -> `MIT AND CC-BY-NC-4.0`."""
    parts: dict[str, None] = {}
    for licence in licences:
        text = licence.strip() or UNKNOWN
        # AND binds closer than OR; what is in brackets stays as it is.
        is_choice = "(" in text or " OR " in text
        parts |= dict.fromkeys([text] if is_choice else text.split(" AND "))
    if len(parts) < 2:
        return next(iter(parts), UNKNOWN)
    return " AND ".join(
        f"({part})" if " OR " in part and not part.startswith("(") else part for part in parts
    )
