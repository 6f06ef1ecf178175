"""flags: exactly one row with an end flag per episode, its last; truncation only at the horizon.

Both flags may be set on that row. Where no horizon is known (imports) only the ends are looked at.
"""

from __future__ import annotations

import numpy as np

from mpdt.data.verify.finding import Finding, drop_hint, judge
from mpdt.data.verify.material import Chunk, Material, Track
from mpdt.data.verify.streaming import Faults


class FlagsCheck:
    """StepCheck `flags`."""

    id = "flags"

    def __init__(self, material: Material) -> None:
        self._material, self._faults = material, Faults()

    def look(self, track: Track, chunk: Chunk) -> None:
        last = chunk.starts + chunk.lengths - 1
        ends = chunk.terminations | chunk.truncations
        count = np.add.reduceat(ends.astype(np.int64), chunk.starts)

        def add(what: str, wrong: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> None:
            self._faults.add(what, track, (np.flatnonzero(wrong) + chunk.first).tolist())

        add("no end flag on the last row", ~ends[last])
        add("an end flag before the last row", count - ends[last] > 0)
        if track.horizon is not None:
            truncated = chunk.truncations[last]
            add(f"longer than the horizon of {track.horizon}", chunk.lengths > track.horizon)
            add("truncated before the horizon", truncated & (chunk.lengths < track.horizon))
            at_end = ~truncated & ends[last] & (chunk.lengths == track.horizon)
            add("not truncated at the horizon", at_end)

    def finding(self) -> Finding:
        horizon = self._material.own().horizon
        where = f", truncation at step {horizon}" if horizon is not None else ""
        faults = self._faults.all()
        hint = drop_hint(self._material.dataset, faults)
        return judge(self.id, faults, f"one end per episode{where}", hint)
