"""leak: neither statistics nor a training slice know a test-only task; slice ids are absolute."""

from __future__ import annotations

import numpy as np

from mpdt.data.store.dataset import Dataset
from mpdt.data.store.digest import content_hash
from mpdt.data.verify.finding import Fault, Finding, fault, judge, nothing
from mpdt.data.verify.material import Material
from mpdt.errors import quoted

ID = "leak"


def check_leak(material: Material) -> Finding:
    data = material.dataset
    faults = _stats_faults(data)
    hint = f"mpdt-data split {quoted(material.path)} --train -o OUT.h5 computes them again"
    slices = [*_slice_faults(material)]
    if slices and not faults:
        hint = (
            f"mpdt-data split {quoted(material.path)} --train --name train writes that slice again"
        )
    if data.stats_info is None and not data.slices:
        return nothing(ID, "neither statistics nor slices")
    saw = "no stats" if data.stats_info is None else "stats saw train tasks only"
    passed = f"{saw}; {len(data.slices)} slices with absolute ids"
    return judge(ID, faults + slices, passed, hint)


def _stats_faults(data: Dataset) -> list[Fault]:
    info = data.stats_info
    if info is None:
        return []
    train = set(data.tasks.train_rows)
    names = [
        data.tasks.names[row] if 0 <= row < len(data.tasks) else f"row {row}"
        for row in sorted(set(info.tasks_seen) - train)
    ]
    if names:
        return [Fault(f"statistics saw test tasks: {', '.join(names[:3])}")]
    ids = data.select(task=sorted(info.tasks_seen), slice=info.slice or None)
    stored = set(data.episodes.task[ids].tolist())
    if not stored or stored != set(info.tasks_seen):
        return []  # a cut-out without training episodes keeps the statistics of its source
    lengths = data.episodes.length[ids].astype(np.int64)
    counts = {
        "observations": int(lengths.sum()) + len(ids),
        "actions": int(lengths.sum()),
        "rewards": int(lengths.sum()),
        "returns": len(ids),
    }
    faults = []
    for field, count in counts.items():
        found = info.fields[field]["count"]
        if (found != count).any():
            what = f"statistics of {field} are over {found[0]:,.0f} rows"
            faults.append(Fault(f"{what}, their tasks have {count:,}"))
    return faults


def _slice_faults(material: Material) -> list[Fault]:
    data, faults = material.dataset, []
    train = np.array(data.tasks.train_rows, np.int64)
    # Either will do: what does not fit there is told by `hash`.
    own = (data.content_hash, content_hash(data.content_header(), data.episodes.digest))
    for name, ids in data.slices.items():
        if len(outside := ids[(ids < 0) | (ids >= data.num_episodes)]):
            faults.append(fault(f"slice {name} points outside the file", outside))
            continue
        steps = np.diff(ids)
        if (steps <= 0).any():
            what = "has an id twice" if (steps == 0).any() else "is not ascending"
            faults.append(fault(f"slice {name} {what}", ids[1:][steps <= 0]))
        if material.slice_parents.get(name) not in own:
            faults.append(Fault(f"slice {name} was made for another file"))
        rule = data.slice_rules[name]
        if name == "train" or rule.get("role") == "train" or "validation" in rule:
            leaked = ids[~np.isin(data.episodes.task[ids], train)]
            if len(leaked):
                faults.append(fault(f"slice {name} holds test tasks", leaked))
    return faults
