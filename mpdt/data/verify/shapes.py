"""shapes: lengths agree, offsets tile the arrays without gap or overlap, rows are in range.

Everything after this check believes offsets and rows, so it runs first and alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mpdt.data.store import layout
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.origin import damaged_hint
from mpdt.data.verify.finding import Fault, Finding, fault, judge
from mpdt.data.verify.material import Material, Track

ID = "shapes"
STEP_NAMES = {column.path for column in layout.STEPS}


def check_shapes(material: Material) -> Finding:
    data = material.dataset
    faults = _length_faults(material)
    if not faults:  # else nothing can be compared row by row
        faults = [*_row_faults(data)]
        for track in material.tracks():
            faults += _tiling_faults(track)
    passed = (
        f"{len(data.steps.observations):,} observation rows for {data.num_steps:,} steps, "
        "no gap or overlap"
    )
    return judge(ID, faults, passed, damaged_hint(material.path, data) if faults else "")


def _length_faults(material: Material) -> list[Fault]:
    """Columns of one table that are not equally long; arrays that are not equally wide."""
    data = material.dataset
    tables: dict[str, dict[str, int]] = {}
    for track in material.tracks():
        rows = {"actions": len(track.actions), "rewards": len(track.rewards)}
        rows |= {"terminations": len(track.terminations), "truncations": len(track.truncations)}
        if track.successes is not None:
            rows["successes"] = len(track.successes)
        tables[f"{track.label or 'file'}: steps"] = rows
        tables[f"{track.label or 'file'}: episodes"] = {
            name: len(column)
            for name, column in vars(track.table).items()
            if isinstance(column, np.ndarray) and name not in STEP_NAMES
        }
    for name in ("tasks", "goals", "policies"):
        tables[name] = {
            key: len(column)
            for key, column in vars(getattr(data, name)).items()
            if isinstance(column, np.ndarray | tuple)
        }
    faults = [
        Fault(f"{table} disagree in length: {_text(columns)}")
        for table, columns in tables.items()
        if len(set(columns.values())) > 1
    ]
    for track in material.tracks():
        found = (track.observations.shape[1], track.actions.shape[1])
        wanted = (data.observation_size, data.action_size)
        if found != wanted:
            faults.append(Fault(f"{found} columns instead of {wanted}", track=track.label))
    return faults


def _text(columns: dict[str, int]) -> str:
    """The odd ones out: `rewards 499, others 500`."""
    counts = list(columns.values())
    usual = max(set(counts), key=counts.count)
    odd = [f"{name} {count}" for name, count in columns.items() if count != usual]
    return f"{', '.join(odd[:3])}, others {usual}"


def _row_faults(data: Dataset) -> list[Fault]:
    """Row numbers that point outside their table."""
    tasks, goals, policies = len(data.tasks), len(data.goals.dims), len(data.policies.names)
    checks: list[tuple[str, Any, int, str]] = [
        ("task", data.episodes.task, tasks, ""),
        ("policy", data.episodes.policy, policies, ""),
        ("goal", data.episodes.goal, goals, ""),
        *((f"tta {n} task", tta.task, tasks, f"tta {n}") for n, tta in data.tta.items()),
        *((f"tta {n} goal", tta.goal, goals, f"tta {n}") for n, tta in data.tta.items()),
    ]
    faults = []
    for name, rows, count, track in checks:
        wrong = np.flatnonzero((rows < 0) | (rows >= count))
        if len(wrong):
            faults.append(fault(f"{name} points outside its table of {count}", wrong, track))
    tables: list[tuple[str, Any, int]] = [
        ("/tasks/role", data.tasks.roles, len(layout.ROLE_CODES)),
        ("/goals/task", data.goals.tasks, tasks),
        ("/goals/dim", data.goals.dims, data.goals.values.shape[1] + 1),
        ("/policies/task", data.policies.tasks, tasks),
    ]
    for name, rows, count in tables:
        if ((rows < 0) | (rows >= count)).any():
            faults.append(Fault(f"{name} points outside its table of {count}"))
    return faults


def _tiling_faults(track: Track) -> list[Fault]:
    table, label = track.table, track.label
    length = table.length.astype(np.int64)
    if (short := np.flatnonzero(length < 1)).size:
        return [fault("without a step", short, label)]
    start = np.cumsum(length) - length
    faults = []
    for name, wanted in (("start", start), ("obs_start", start + np.arange(len(length)))):
        wrong = np.flatnonzero(getattr(table, name) != wanted)
        if len(wrong):
            faults.append(fault(f"{name} leaves a gap or overlaps", wrong, label))
    steps, episodes = int(length.sum()), len(length)
    for name, found, rows in (
        ("steps", len(track.actions), steps),
        ("observation rows", len(track.observations), steps + episodes),
    ):
        if found != rows:
            faults.append(Fault(f"{found:,} {name} for episodes that have {rows:,}", track=label))
    return faults
