"""tta: a preset return, uniform actions inside the bounds, nested sets.

Uniform: mean and mean square of each action component lie within five standard errors of those of
a uniform distribution. Nested: seed keys ascend per task, so that the first n episodes are the set
of size n; and of two sets with one rule the smaller begins the larger.
"""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

from mpdt.data.store.tables import TtaSet
from mpdt.data.verify.finding import Fault, Finding, fault, judge, nothing
from mpdt.data.verify.material import Material
from mpdt.errors import quoted
from mpdt.seeding import UNKNOWN_SEED_KEY

ID = "tta"
STANDARD_ERRORS = 5.0


def check_tta(material: Material) -> Finding:
    data = material.dataset
    if not data.tta:
        return nothing(ID, "no sets")
    found = {
        name: [*_number_faults(name, tta), *_order_faults(name, tta)]
        for name, tta in data.tta.items()
    }
    faults = [one for some in found.values() for one in some]
    wrong = next((name for name, some in found.items() if some), next(iter(found)))
    for (name, one), (other, two) in combinations(data.tta.items(), 2):
        if dict(one.rule) == dict(two.rule):
            faults += _nesting_faults(f"{name} and {other}", one, two)
    shown = ", ".join(f"{name}: {len(tta):,} episodes" for name, tta in data.tta.items())
    hint = (f"mpdt-data tta {quoted(material.path)} --name {quoted(wrong)} --overwrite makes the "
            "set again")  # fmt: skip
    return judge(ID, faults, f"{shown}; actions uniform, sets nested", hint)


def _number_faults(name: str, tta: TtaSet) -> list[Fault]:
    track, faults = f"tta {name}", []
    wrong = np.flatnonzero(~np.isfinite(tta.preset_return))
    if len(wrong):
        faults.append(fault("no preset return", wrong, track))
    for row in np.unique(tta.task):
        ids = tta.of_task(int(row))
        other = ids[tta.preset_return[ids] != tta.preset_return[ids[0]]]
        if len(other) and not len(wrong):
            faults.append(fault("asks for several returns of one task", other, track))
    try:
        low, high, scale = (float(tta.rule[key]) for key in ("low", "high", "action_scale"))
    except (KeyError, TypeError, ValueError):
        return [*faults, Fault("its rule has no low, high and action_scale", track=track)]
    low, high = low * scale, high * scale
    actions = tta.actions
    # The last bit: bounds were multiplied in float64 and actions drawn in float32.
    edge = 1e-6 * max(abs(low), abs(high))
    outside = np.flatnonzero(((actions < low - edge) | (actions > high + edge)).any(axis=1))
    if len(outside):
        ids = np.unique(np.searchsorted(tta.start, outside, side="right") - 1)
        return [*faults, fault(f"actions outside [{low:g}, {high:g}]", ids, track)]
    if len(actions) and not (np.isfinite(actions).all() and high > low):
        return faults  # `values` names the episodes
    unit = (actions.astype(np.float64) - low) / (high - low) if len(actions) else actions
    for what, value, mean, spread in (
        ("mean", unit, 1 / 2, math.sqrt(1 / 12)),
        ("spread", (unit - 0.5) ** 2, 1 / 12, math.sqrt(1 / 180)),
    ):
        if not len(value):
            break
        error = spread / math.sqrt(len(value))
        off = np.flatnonzero(abs(value.mean(axis=0) - mean) > STANDARD_ERRORS * error)
        if len(off):
            some = ", ".join(map(str, off.tolist()[:3]))
            text = f"{what} of action component {some} is not that of uniform actions"
            faults.append(Fault(text, track=track, is_doubt=True))
    return faults


def _order_faults(name: str, tta: TtaSet) -> list[Fault]:
    """Ascending (task, block, row): otherwise the first n are not the set of size n."""
    keys = [(int(t), int(k[3]), int(k[4])) for t, k in zip(tta.task, tta.seed_key, strict=True)]
    unknown = UNKNOWN_SEED_KEY[0]  # imported sets have no keys to compare
    wrong = [
        i for i in range(1, len(keys))
        if keys[i] < keys[i - 1] or (keys[i] == keys[i - 1] and keys[i][1] != unknown)
    ]  # fmt: skip
    return [fault("not in the order of their seed keys", wrong, f"tta {name}")] if wrong else []


def _nesting_faults(names: str, one: TtaSet, two: TtaSet) -> list[Fault]:
    for row in sorted({*one.task.tolist()} & {*two.task.tolist()}):
        small, large = sorted((one.digest[one.task == row], two.digest[two.task == row]), key=len)
        if (small != large[: len(small)]).any():
            return [Fault(f"{names} have one rule, but neither begins the other (task row {row})")]
    return []
