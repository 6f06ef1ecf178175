"""Places: where the episodes of several files belong in one, each once, in canonical order.

a.h5   task 0: random 0-199                    task 0: random 0-199 of a
b.h5   task 0: random 0-99, expert 0-99                expert 0-99 of b      100 repeated
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.store.dataset import Dataset
from mpdt.data.store.tables import Int64
from mpdt.errors import DataError, quoted
from mpdt.seeding import UNKNOWN_SEED_KEY


@dataclass(frozen=True, eq=False)
class Places:
    """E episodes: number of the file (E,) and id in that file (E,).

    num_repeated: how many more there were in the files, equal to one of these.
    """

    source: Int64
    id: Int64
    num_repeated: int = 0

    def __len__(self) -> int:
        return len(self.id)

    def column(self, columns: Sequence[NDArray[Any]]) -> NDArray[Any]:
        """One column of the episodes (E, ...), put together from that of each file."""
        found = np.empty((len(self), *columns[0].shape[1:]), columns[0].dtype)
        for number, column in enumerate(columns):
            here = self.source == number
            found[here] = column[self.id[here]]
        return found


def find_places(sources: Sequence[Dataset]) -> Places:
    """All episodes in canonical order, each once; equal ones count where they come first.

    Raises: DataError where two files hold different episodes of one place.
    """
    every = Places(
        np.repeat(np.arange(len(sources)), [source.num_episodes for source in sources]),
        np.concatenate([np.arange(source.num_episodes) for source in sources]),
    )
    key = np.column_stack([
        every.column([np.asarray(s.tasks.indices, np.int64)[s.episodes.task] for s in sources]),
        every.column([s.episodes.quality for s in sources]),
        every.column([s.episodes.seed_key[:, 3:] for s in sources]),
    ]).astype(np.int64)  # fmt: skip
    order = np.lexsort(key.T[::-1])  # stable: in one place in the order of files and ids
    key, every = key[order], Places(every.source[order], every.id[order])
    group = np.cumsum(np.r_[False, (key[1:] != key[:-1]).any(axis=1)])
    shared = np.flatnonzero(np.bincount(group, minlength=1)[group] > 1)
    if not len(shared):
        return every
    once = shared[_first_of_equals(group[shared], _digests(sources, every, shared))]
    again = once[1:][group[once[1:]] == group[once[:-1]]]
    is_known = (key[again, 2:] != UNKNOWN_SEED_KEY[3:]).any(axis=1)
    if is_known.any():
        second = int(again[is_known][0])
        raise _contradiction(
            sources, every, int(np.searchsorted(group, group[second])), second, key
        )
    kept = np.ones(len(every), np.bool_)
    kept[shared], kept[once] = False, True
    return Places(every.source[kept], every.id[kept], int((~kept).sum()))


def _digests(sources: Sequence[Dataset], every: Places, rows: Int64) -> NDArray[np.uint8]:
    return Places(every.source[rows], every.id[rows]).column([s.episodes.digest for s in sources])


def _first_of_equals(group: Int64, digest: NDArray[np.uint8]) -> Int64:
    """Ascending positions of the first of those that are equal in both."""
    both = np.column_stack([group.astype(">u8")[:, None].view(np.uint8), digest])
    words = np.ascontiguousarray(both).view(f"V{both.shape[1]}")[:, 0]
    return np.sort(np.unique(words, return_index=True)[1])


def _contradiction(
    sources: Sequence[Dataset], every: Places, one: int, two: int, key: Int64
) -> DataError:
    paths = [sources[every.source[row]].path for row in (one, two)]
    return DataError(
        "two files hold different episodes of one place",
        where=f"{paths[0]}: episode {every.id[one]}, {paths[1]}: episode {every.id[two]}",
        found="task {}, quality {}, block {}, row {}".format(*key[two]),
        hint=f"see what differs: mpdt-data diff {quoted(paths[0])} {quoted(paths[1])}",
    )
