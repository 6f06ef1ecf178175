"""Bundles at other places: brought once, kept in the cache, and proved like any other.

hf://OWNER/NAME     ~/.cache/mpdt/policies/NAME-1a2b3c4d5e6f     named after the address
"""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path

from mpdt.disk import disk
from mpdt.train.bundle.read import is_bundle


def fetched(url: str) -> Path:
    """The bundle of that address, here; the network is asked only where it is not yet.

    Raises: as `mpdt.data.remote.pull`, and `StorageError` where the cache cannot be written.
    """
    target = cache_folder() / cached_name(url)
    if is_bundle(target):
        return target
    # What connects is asked for by those alone who connect.
    from mpdt.data.remote.pull import pull

    with disk(target):
        target.parent.mkdir(parents=True, exist_ok=True)
    pull(url, target)
    return target


def cached_name(url: str) -> str:
    """Readable, and another one for every address."""
    last = re.sub(r"[^\w.-]", "", url.rstrip("/").rpartition("/")[2].partition("?")[0])
    return f"{last[:40] or 'policy'}-{hashlib.sha256(url.encode()).hexdigest()[:12]}"


def cache_folder() -> Path:
    """`$XDG_CACHE_HOME/mpdt/policies`; may be deleted at any time."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "mpdt" / "policies"
