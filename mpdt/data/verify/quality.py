"""quality: return(random) < return(medium) < return(expert) per task, medium half-way.

The order is that of the stored episodes, with the references for what is not stored; the level of
medium is measured between the references. A level outside its band by no more than its error, a
smoke version, and imported files warn.
"""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np

from mpdt.data.collect.levels import TaskLevels
from mpdt.data.episode import QUALITY_CODES
from mpdt.data.reference import Reference, References
from mpdt.data.store.origin import again_hint
from mpdt.data.verify.finding import Fault, Finding, fault, judge, nothing
from mpdt.data.verify.material import Material
from mpdt.errors import quoted

ID = "quality"
ORDER = ("random", "medium", "expert")


def check_quality(material: Material) -> Finding:
    data, soft = material.dataset, material.is_imported or material.is_smoke
    faults, shown = _column_faults(material), []
    ordered, compared = Counter[str](), Counter[str]()
    for row, task in enumerate(data.tasks.names):
        own = _stored(material, row)
        known = data.tasks.references[row]
        best = {name: own[name] if own[name].is_known else known[name] for name in ORDER}
        order = [name for name in ORDER if best[name].is_known]
        wrong = [(a, b) for a, b in pairwise(order) if not best[a].mean < best[b].mean]
        for a, b in wrong:
            what = f"{task}: {a} {best[a].mean:.1f} is not below {b} {best[b].mean:.1f}"
            ids = data.select(task=row, quality=[a, b])
            faults.append(fault(what, ids, doubt=soft))
        if len(order) > 1:
            compared[" < ".join(order)] += 1
            ordered[" < ".join(order)] += not wrong
        if wrong or not own["medium"].is_known:
            continue
        ends = {name: known[name] if known[name].is_known else own[name] for name in ORDER}
        levels = TaskLevels(task, References(ends), own["medium"])
        if not np.isnan(levels.medium_level):
            shown.append(levels.medium_level)
        ids = data.select(task=row, quality="medium")
        faults += [fault(text, ids, doubt=soft) for text in levels.faults()]
        faults += [Fault(text, is_doubt=True) for text in levels.doubts()]
    if not compared and not faults:
        return nothing(ID, "no task has two of random, medium and expert, stored or on record")
    text = ", ".join(f"{order} in {ordered[order]}/{n} tasks" for order, n in compared.items())
    if shown:
        text += f"; medium level {min(shown):.2f} to {max(shown):.2f}"
    hint = f"mpdt-data show {quoted(material.path)}; then {again_hint(data)}"
    return judge(ID, faults, text, hint)


def _stored(material: Material, row: int) -> dict[str, Reference]:
    """What each quality returned on one task; unknown where it has no episodes."""
    data = material.dataset
    return {
        name: Reference.of(data.episodes.returns[data.select(task=row, quality=name)])
        for name in ORDER
    }


def _column_faults(material: Material) -> list[Fault]:
    episodes = material.dataset.episodes
    faults = []
    known = [*QUALITY_CODES.values(), -1]
    if len(wrong := np.flatnonzero(~np.isin(episodes.quality, known))):
        faults.append(fault("no such quality code", wrong))
    with np.errstate(invalid="ignore"):
        inside = (episodes.progress >= 0) & (episodes.progress <= 1)
    if len(wrong := np.flatnonzero(~(inside | (episodes.progress == -1)))):
        faults.append(fault("progress outside [0, 1]", wrong))
    ends = (("random", 0.0), ("expert", 1.0))
    for name, progress in ends:
        other = (episodes.progress != progress) & (episodes.progress != -1)
        wrong = np.flatnonzero((episodes.quality == QUALITY_CODES[name]) & other)
        if len(wrong):
            faults.append(fault(f"{name} with another progress than {progress:g}", wrong))
    return faults
