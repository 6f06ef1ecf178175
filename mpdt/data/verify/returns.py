"""returns: the stored return is the sum of the rewards, success is any of the steps."""

from __future__ import annotations

import numpy as np

from mpdt.data.store.origin import again_hint
from mpdt.data.store.tables import Episodes
from mpdt.data.verify.finding import Fault, Finding, judge
from mpdt.data.verify.material import Chunk, Material, Track
from mpdt.data.verify.streaming import Faults
from mpdt.errors import quoted

REQUIRED = ("zero", "random", "expert")


class ReturnsCheck:
    """StepCheck `returns`."""

    id = "returns"

    def __init__(self, material: Material) -> None:
        self._material, self._faults = material, Faults()

    def look(self, track: Track, chunk: Chunk) -> None:
        table = track.table
        if not isinstance(table, Episodes):
            return
        stored = table.returns[chunk.first : chunk.last]
        ends = chunk.starts + chunk.lengths
        # Episode by episode: numpy sums pairwise, and only so is the last bit the stored one.
        sums = np.array([
            chunk.rewards[start:end].sum(dtype=np.float64)
            for start, end in zip(chunk.starts.tolist(), ends.tolist(), strict=True)
        ])  # fmt: skip
        wrong = (sums != stored) & ~(np.isnan(sums) & np.isnan(stored))
        ids = (np.flatnonzero(wrong) + chunk.first).tolist()
        self._faults.add("return is not the sum of the rewards", track, ids)
        any_success = np.zeros(len(stored), np.bool_)
        if chunk.successes is not None:
            any_success = np.logical_or.reduceat(chunk.successes, chunk.starts)
        wrong = any_success != table.success[chunk.first : chunk.last]
        ids = (np.flatnonzero(wrong) + chunk.first).tolist()
        self._faults.add("success is not any of its steps", track, ids)

    def finding(self) -> Finding:
        material, faults = self._material, self._faults.all()
        tasks = material.dataset.tasks
        for name in REQUIRED:
            unknown = [tasks.names[r] for r in np.flatnonzero(~np.isfinite(tasks.means(name)))]
            if unknown:
                some = ", ".join(unknown[:3]) + (" ..." if len(unknown) > 3 else "")
                doubt = material.is_imported
                faults.append(Fault(f"reference {name} unknown: {some}", is_doubt=doubt))
        hint = f"mpdt-data show {quoted(material.path)} lists returns and references"
        if not material.is_imported:  # an import never has more than its source said
            hint += f"; {again_hint(material.dataset)}"
        return judge(self.id, faults, "stored = recomputed, references finite", hint)
