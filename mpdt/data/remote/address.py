"""Addresses without their secrets: what may be printed, stored or parsed of a URL.

    sftp://ann:pw@host/x.h5         sftp://ann:***@host/x.h5
    https://token@host/x.h5         https://***@host/x.h5
    https://host/x.h5?Signature=ab  https://host/x.h5?Signature=***

`mpdt-data` hides what was typed before anything else sees it, and `revealed` gives it to the
library that connects. Nothing here imports more than the standard library.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from urllib.parse import unquote

# Greedy: a password may hold the very marks that a URL would have to escape.
_PASSWORD = re.compile(r"(://[^\s:/@]*:)(\S+)@")
_TOKEN = re.compile(r"(?<!sftp)(?<!ssh)(://)([^\s:/@]+)@")
_QUERY = re.compile(r"([?&][^\s=&]+=)([^\s&]+)")
_PATTERNS = ((_PASSWORD, r"\1***@"), (_TOKEN, r"\1***@"), (_QUERY, r"\1***"))

_typed: dict[str, str] = {}  # hidden -> as typed, for this process alone


def hidden(url: str) -> str:
    """The URL with `***` where its password, token or signature was."""
    if "://" not in url:
        return url
    for pattern, shown in _PATTERNS:
        url = pattern.sub(shown, url)
    return url


def hide(words: Sequence[str]) -> list[str]:
    """A command line to show and to parse; `revealed` knows what was typed."""
    safe = [hidden(word) for word in words]
    _typed.update((a, b) for a, b in zip(safe, words, strict=True) if a != b)
    return safe


def revealed(url: str) -> str:
    """What was typed for a URL out of `hide`; any other URL as it is."""
    return _typed.get(url, url)


def without_secrets(text: str, url: str) -> str:
    """A library's words about `url`, which may quote all or parts of it."""
    secrets = {match[2] for pattern, _ in _PATTERNS for match in pattern.finditer(url)}
    for secret in sorted(secrets | {unquote(secret) for secret in secrets}, key=len, reverse=True):
        text = text.replace(secret, "***")
    return hidden(text)


def last_name(url: str) -> str:
    """`x.h5` of `sftp://host/data/x.h5`; empty for a URL that ends with a slash."""
    return url.partition("?")[0].rpartition("/")[2]
