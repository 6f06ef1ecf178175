"""Digests of many episodes at once, straight from the arrays of a file.

The fast twin of `digest.episode_digest`: nothing is copied, and no Episode is made, so that it
also works on episodes that break an Episode's promises. Equality is tested.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.episode import UNKNOWN_POLICY
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.tables import TtaSet
from mpdt.seeding import Quality


def _head(name: str, dtype: str, shape: str) -> bytes:
    return f"{name}\0{dtype}\0{shape}\0".encode()


def _part(name: str, dtype: str, value: Any) -> bytes:
    array = np.ascontiguousarray(value, dtype=dtype).reshape(np.shape(value))
    return _head(name, dtype, ",".join(map(str, array.shape))) + array.tobytes()


class Labels:
    """What of each digest follows the step arrays; each part is put into bytes once.

    Rows must point into their tables (`shapes` passed).
    """

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset
        names = (np.frombuffer(name.encode("utf-8"), np.uint8) for name in dataset.tasks.names)
        self._tasks = [_part("task", "|u1", name) for name in names]
        self._policies = [_part("policy", "|u1", row) for row in dataset.policies.hashes]
        self._unknown = _part("policy", "|u1", np.frombuffer(UNKNOWN_POLICY, np.uint8))
        self._seed = _head("seed_key", "<u4", "5")
        self._goal = lru_cache(maxsize=1 << 16)(
            lambda row: _part("goal", "<f8", dataset.goals.of(row))
        )
        self._place = lru_cache(maxsize=1 << 12)(
            lambda quality, progress: (
                _part("quality", "|i1", quality) + _part("progress", "<f4", progress)
            )
        )

    def episode(self, i: int) -> bytes:
        """Of the file's own episode `i`."""
        table = self._dataset.episodes
        return b"".join((
            self._tasks[table.task[i]], self._goal(int(table.goal[i])),
            self._place(int(table.quality[i]), float(table.progress[i])),
            self._policies[table.policy[i]], self._seed, table.seed_key[i].tobytes(),
        ))  # fmt: skip

    def tta(self, tta: TtaSet, i: int) -> bytes:
        """Of episode `i` of a TTA set, which stores no policy and no progress."""
        return b"".join((
            self._tasks[tta.task[i]], self._goal(int(tta.goal[i])),
            self._place(int(Quality.TTA), 0.0), self._unknown, self._seed,
            tta.seed_key[i].tobytes(),
        ))  # fmt: skip


def array_digests(
    arrays: Sequence[tuple[str, NDArray[Any]]],
    lengths: Sequence[int],
    labels: Sequence[bytes],
) -> bytes:
    """32-byte digests of consecutive episodes, one after another.

    Args:
        arrays: name and rows of each step array in the digest's order, `observations` with one
            row more per episode; C-contiguous.
        lengths: T of each episode.
        labels: of each episode, from `Labels`.
    """
    views = [memoryview(array.data).cast("B") for _, array in arrays]
    strides = [array.dtype.itemsize * int(np.prod(array.shape[1:])) for _, array in arrays]
    extra = [int(name == "observations") for name, _ in arrays]
    kinds = tuple((name, array.dtype.str, array.shape[1:]) for name, array in arrays)
    places = [0] * len(arrays)
    digests = []
    for length, label in zip(lengths, labels, strict=True):
        state = hashlib.sha256()
        for i, head in enumerate(_heads(kinds, length)):
            end = places[i] + strides[i] * (length + extra[i])
            state.update(head)
            state.update(views[i][places[i] : end])
            places[i] = end
        state.update(label)
        digests.append(state.digest())
    return b"".join(digests)


@lru_cache(maxsize=4096)
def _heads(kinds: tuple[tuple[str, str, tuple[int, ...]], ...], length: int) -> list[bytes]:
    return [
        _head(name, dtype, ",".join(map(str, (length + (name == "observations"), *rest))))
        for name, dtype, rest in kinds
    ]
