"""Bundles at other places: brought once, kept in the cache, and proved like any other.

hf://OWNER/NAME     ~/.cache/mpdt/policies/NAME-1a2b3c4d5e6f     named after the address
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpdt.data.remote.address import last_name
from mpdt.disk import disk
from mpdt.train.bundle.read import is_bundle, read_contents

# What connects (fsspec and those behind it) is imported by those alone who connect.


def fetched(url: str) -> Path:
    """The bundle of that address, here; the network is asked only where it is not yet.

    Raises: as `mpdt.data.remote.pull`, and `StorageError` where the cache cannot be written.
    """
    target = cache_folder() / cached_name(url)
    if is_bundle(target):
        return target
    from mpdt.data.remote.pull import pull

    with disk(target):
        target.parent.mkdir(parents=True, exist_ok=True)
    pull(url, target)
    return target


def cached_name(url: str) -> str:
    """Readable, without secrets, and another one for every address."""
    last = re.sub(r"[^\w.-]", "", last_name(url.rstrip("/")))
    return f"{last[:40] or 'policy'}-{hashlib.sha256(url.encode()).hexdigest()[:12]}"


def cache_folder() -> Path:
    """`$XDG_CACHE_HOME/mpdt/policies`; may be deleted at any time."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "mpdt" / "policies"


def push_bundle(
    folder: Path, url: str, replace: bool, check: bool, say: Callable[[str], None]
) -> tuple[dict[str, Any], str]:
    """Send a bundle, every byte of which is proved before; facts and a line about what was sent.

    Args:
        say: takes lines of progress.
    Raises: as `mpdt.data.remote.push` and `read_contents`.
    """
    from mpdt.data.remote.push import push
    from mpdt.data.verbs.remote import line_writer, summary

    read_contents(folder)
    sent = push(folder, url, replace, check, line_writer("push", say), kind="model")
    facts = {"url": sent.address, "files": sent.num_files, "bytes": sent.num_bytes,
             "moved_bytes": sent.num_new_bytes, "checked": sent.checked}  # fmt: skip
    return facts, summary("pushed ", sent.address, *list(facts.values())[1:4])


def pull_bundle(
    url: str, target: Path | None, say: Callable[[str], None]
) -> tuple[dict[str, Any], str]:
    """Bring a bundle, proved by its list of sums, then by its digests; facts and a line about it.

    Args, Raises: as `mpdt.data.remote.pull` and `read_contents`.
    """
    from mpdt.data.remote.pull import pull
    from mpdt.data.verbs.remote import line_writer, summary

    found = pull(url, target, tell=line_writer("pull", say))
    read_contents(found.path)
    facts = {"path": str(found.path), "files": found.num_files, "bytes": found.num_bytes,
             "moved_bytes": found.num_new_bytes}  # fmt: skip
    return facts, summary("pulled ", str(found.path), *list(facts.values())[1:])
