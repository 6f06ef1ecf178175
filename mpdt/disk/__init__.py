"""Disk: the one way to leave anything on it. Used by all that writes.

    replacing, write_bytes    a file          holding      longer than one write: look, work, write
    appearing                 a folder        disk         what the system refuses, as one error

A writer holds its target, so that two that meet wait for each other or are told; writes beside it,
under a name nobody else has; flushes; and renames, if the target still is what it was.
"""

from mpdt.disk.content import reserve, sha256, sync, sync_tree
from mpdt.disk.hold import Hold, Seen, holding, real_path, sweep
from mpdt.disk.refusal import disk, expect_folder, expect_rights, expect_room
from mpdt.disk.replace import (
    appearing,
    check_replaceable,
    last_put,
    put_file,
    put_folder,
    replacing,
    write_bytes,
)

__all__ = ["Hold", "Seen", "appearing", "check_replaceable", "disk", "expect_folder",
           "expect_rights", "expect_room", "holding", "last_put", "put_file", "put_folder",
           "real_path", "replacing", "reserve", "sha256", "sweep", "sync", "sync_tree",
           "write_bytes"]  # fmt: skip
