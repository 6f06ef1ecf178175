"""duplicates: episodes with equal observation and action bytes.

Digests cannot show them, because they contain the seed key. Warns inside a task and among
training tasks; fails where a training and a test task share an episode.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

from mpdt.data.store.tables import Float32
from mpdt.data.verify.finding import Fault, Finding, judge, nothing
from mpdt.data.verify.material import Chunk, Material, Track
from mpdt.errors import quoted

Words = NDArray[np.uint64]


def row_hash(rows: Float32) -> Words:
    """One 64-bit number per row of (n, C) float32; equal rows have equal ones."""
    bits = np.ascontiguousarray(rows).view("<u4").astype(np.uint64)
    factors = np.arange(1, bits.shape[1] + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    return np.asarray((bits * (factors | np.uint64(1))).sum(axis=1, dtype=np.uint64))


class DuplicatesCheck:
    """StepCheck `duplicates`: sorts by a cheap key, then compares bytes where keys are equal."""

    id = "duplicates"

    def __init__(self, material: Material) -> None:
        self._material = material
        self._keys: list[Words] = []

    def look(self, track: Track, chunk: Chunk) -> None:
        if track.label:
            return
        first, last = chunk.starts, chunk.starts + chunk.lengths - 1
        key = chunk.lengths.astype(np.uint64)
        for rows in (
            chunk.observations[chunk.obs_starts],
            chunk.observations[chunk.obs_starts + chunk.lengths],
            chunk.actions[first],
            chunk.actions[last],
        ):
            key = key * np.uint64(0xD6E8FEB86659FD93) + row_hash(rows)
        self._keys.append(key)

    def finding(self) -> Finding:
        groups = self._groups()
        data = self._material.dataset
        train, test = set(data.tasks.train_rows), set(data.tasks.test_rows)
        faults: list[Fault] = []
        for ids in groups:
            rows = sorted({int(data.episodes.task[i]) for i in ids})
            shared = any(a in train and b in test for a in rows for b in rows if a != b)
            names = ", ".join(data.tasks.names[row] for row in rows)
            where = f"train and test share episodes (tasks {names})" if shared else f"task {names}"
            faults.append(Fault(f"{where}, same observations and actions", tuple(ids), len(ids),
                                is_doubt=not shared))  # fmt: skip
        faults.sort(key=lambda one: one.is_doubt)
        hint = ""
        if faults:
            extra = [str(i) for i in faults[0].episodes[1:4]]
            command = f"mpdt-data drop {quoted(self._material.path)} --episodes {','.join(extra)}"
            hint = f"{command} -o OUT.h5"
        if len(self._material.dataset.episodes) < 2:
            return nothing(self.id, "no two episodes")
        return judge(self.id, faults, f"no episode twice among {len(data.episodes):,}", hint)

    def _groups(self) -> list[list[int]]:
        """Ids of equal episodes, each group ascending, groups by their first id."""
        if not self._keys:
            return []
        keys = np.concatenate(self._keys)
        _, place, counts = np.unique(keys, return_inverse=True, return_counts=True)
        candidates = np.flatnonzero(counts[place] > 1)
        equal: dict[tuple[int, bytes], list[int]] = {}
        for i in candidates.tolist():
            equal.setdefault((int(keys[i]), self._bytes_hash(i)), []).append(i)
        return [ids for ids in equal.values() if len(ids) > 1]

    def _bytes_hash(self, i: int) -> bytes:
        steps, table = self._material.dataset.steps, self._material.dataset.episodes
        start, length, obs = int(table.start[i]), int(table.length[i]), int(table.obs_start[i])
        state = hashlib.sha256(steps.observations[obs : obs + length + 1].data)
        state.update(steps.actions[start : start + length].data)
        return state.digest()
