"""FingerContacts: Meta-World's "do both fingers press this geom?", asked of arrays.

Meta-World loops in Python over all contacts of the scene at every step, 190 us in the 14
tasks that ask. Here the contact pairs are read as one (C, 2) array; rows without the geom
are dropped before anything else happens. Same numbers summed in the same order, so the
answer, and with it every reward, is the same bit for bit.

Source of the slow twin: Farama-Foundation/Metaworld, `SawyerXYZEnv.touching_object`.
"""

from __future__ import annotations

from typing import Any

import numpy as np


class FingerContacts:
    """Replacement for the bound method `touching_object` of one Meta-World env."""

    def __init__(self, env: Any) -> None:
        self._data = env.data
        pads = ("leftpad_geom", "rightpad_geom")
        self._pads = tuple(int(env.data.geom(name).id) for name in pads)

    def __call__(self, object_geom_id: int) -> bool:
        """True if both finger pads press the geom with a positive sum of constraint forces."""
        contact = self._data.contact
        pairs = contact.geom
        rows = np.flatnonzero((pairs == object_geom_id).any(axis=1)) if len(pairs) else ()
        if len(rows) == 0:
            return False
        addresses, forces = contact.efc_address, self._data.efc_force
        # A plain left-to-right sum: numpy's pairwise one would round differently.
        sums = [sum(forces[addresses[row]] for row in rows if pad in pairs[row])
                for pad in self._pads]  # fmt: skip
        return bool(sums[0] > 0 and sums[1] > 0)
