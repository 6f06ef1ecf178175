"""values: finite numbers, actions inside the bounds, no column that never moves."""

from __future__ import annotations

import numpy as np

from mpdt.data.store.tables import Float32
from mpdt.data.verify.finding import Fault, Finding, drop_hint, judge
from mpdt.data.verify.material import Chunk, Material, Track
from mpdt.data.verify.streaming import Faults

_FOLD = 64  # rows put side by side, so that numpy's inner loop over columns is long

PADDING = ("object", "previous_object", "goal_", "torso_y")
"""Columns that may be zero throughout: slots of absent objects, hidden goals, a planar robot."""


def column_range(array: Float32) -> tuple[Float32, Float32]:
    """Smallest and largest number of each column of (N, C), N >= 1; NaN where one is NaN."""
    rows, width = array.shape
    folded = rows - rows % _FOLD
    lows, highs = [array[folded:]], [array[folded:]]
    if folded:
        wide = array[:folded].reshape(-1, _FOLD * width)
        lows.append(wide.min(axis=0).reshape(_FOLD, width))
        highs.append(wide.max(axis=0).reshape(_FOLD, width))
    return np.concatenate(lows).min(axis=0), np.concatenate(highs).max(axis=0)


class ValuesCheck:
    """StepCheck `values`."""

    id = "values"

    def __init__(self, material: Material) -> None:
        self._material, self._faults = material, Faults()
        self._ranges: dict[str, tuple[Float32, Float32]] = {}
        family = material.family
        self._bounds = (family.action_low, family.action_high) if family else None

    def look(self, track: Track, chunk: Chunk) -> None:
        columns = {
            "observations": chunk.observations,
            "actions": chunk.actions,
            "rewards": chunk.rewards[:, None],
        }
        for name, array in columns.items():
            low, high = column_range(array)
            if not np.isfinite([low, high]).all():
                rows = np.flatnonzero(~np.isfinite(array).all(axis=1))
                starts = chunk.starts if name != "observations" else chunk.obs_starts
                self._faults.add(f"{name} not finite", track, chunk.episodes_of(rows, starts))
            if track.label:
                continue
            if name == "actions" and self._bounds is not None:
                self._look_at_bounds(track, chunk, low, high)
            before = self._ranges.get(name, (low, high))
            self._ranges[name] = np.minimum(low, before[0]), np.maximum(high, before[1])

    def _look_at_bounds(self, track: Track, chunk: Chunk, low: Float32, high: Float32) -> None:
        assert self._bounds is not None
        least, most = np.float32(self._bounds[0]), np.float32(self._bounds[1])
        if (low < least).any() or (high > most).any():
            outside = (chunk.actions < least) | (chunk.actions > most)
            rows = np.flatnonzero(outside.any(axis=1))
            what = f"actions outside [{least:g}, {most:g}]"
            self._faults.add(what, track, chunk.episodes_of(rows))

    def finding(self) -> Finding:
        bounds = self._bounds
        faults = self._faults.all()
        hint = drop_hint(self._material.dataset, faults)
        faults += self._constant_columns()
        inside = f", actions in [{bounds[0]:g}, {bounds[1]:g}]" if bounds else ""
        return judge(self.id, faults, f"no NaN or infinity{inside}", hint)

    def _constant_columns(self) -> list[Fault]:
        family, faults = self._material.family, []
        for name, (low, high) in self._ranges.items():
            if name == "rewards":
                continue
            for column in np.flatnonzero(low == high).tolist():
                label = f"column {column}"
                if name == "observations" and family and column < len(family.columns):
                    label = f"column {column} ({family.columns[column]})"
                    hidden = column in family.hidden_columns
                    if low[column] == 0 and (hidden or family.columns[column].startswith(PADDING)):
                        continue
                what = f"{name}: {label} is always {low[column]:g}"
                faults.append(Fault(what, is_doubt=True))
        return faults
