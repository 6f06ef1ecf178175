"""Reading ahead, turned off for files that are far larger than memory.

At every page that is missing the kernel reads the next ones as well, megabytes of them. Windows lie
anywhere, so of these nearly all are read in vain, and in little memory they drive out pages that
were read before. Where most of a file fits, reading ahead soon has all of it and is left alone:
measured were 4 times the memory, where it helps, and 16 times, where it costs a factor of 28 to
2,000 (docs/log.md, 2026-11-29).
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

TOO_LARGE = 8
"""Times the memory, between the two that were measured."""


def read_no_further(arrays: Iterable[NDArray[Any]]) -> None:
    """Tell the kernel of the maps behind these arrays that they are read here and there, if their
    files together are too large for it to read ahead. Nothing else changes."""
    maps = [found for array in arrays if (found := _map_of(array)) is not None]
    if maps and sum(one.size() for one in maps) > TOO_LARGE * memory_bytes():
        for one in maps:
            one.madvise(mmap.MADV_RANDOM)


def memory_bytes() -> int:
    """What this process may hold: the machine's memory, or less if a control group that it is in
    says so."""
    least = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    groups = Path("/sys/fs/cgroup")
    with suppress(OSError, ValueError):  # no control groups here
        for line in Path("/proc/self/cgroup").read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            if not controllers:
                root, name = groups, "memory.max"
            elif "memory" in controllers.split(","):
                root, name = groups / "memory", "memory.limit_in_bytes"
            else:
                continue
            own = root / path.lstrip("/")
            for folder in (own, *(one for one in own.parents if one.is_relative_to(root))):
                with suppress(OSError, ValueError):  # "max", or none of its own
                    least = min(least, int((folder / name).read_text()))
    return least


def _map_of(array: Any) -> mmap.mmap | None:
    """The map that an array is a view of."""
    while array is not None and not isinstance(array, mmap.mmap):
        array = getattr(array, "base", None)
    return array
