"""Does an opened file hang together? Cheap checks over its small tables, at every open."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.store.dataset import Dataset
from mpdt.data.store.layout import NAME_LENGTH, ROLE_CODES
from mpdt.errors import FormatError

_AT_ONCE = 1 << 16
"""Rows of a table that are looked at together: what is computed of them stays in the cache."""


def check_tables(dataset: Dataset) -> None:
    """Row numbers point into their tables, numbers are some, and episodes tile the step arrays.

    Wrong offsets would not crash anything later: they would train on other episodes' steps.

    Raises: FormatError naming the first disagreement.
    """
    where, episodes = str(dataset.path), dataset.episodes
    _in_range(dataset.tasks.roles, len(ROLE_CODES), "/tasks/role", where)
    _in_range(episodes.task, len(dataset.tasks), "/episodes/task", where)
    _in_range(episodes.policy, len(dataset.policies.names), "/episodes/policy", where)
    _in_range(episodes.goal, len(dataset.goals.dims), "/episodes/goal", where)
    _in_range(dataset.goals.tasks, len(dataset.tasks), "/goals/task", where)
    _in_range(dataset.goals.dims, dataset.goals.values.shape[1] + 1, "/goals/dim", where)
    _in_range(dataset.policies.tasks, len(dataset.tasks), "/policies/task", where)
    _numbers(dataset, where)
    _tiles(episodes, len(dataset.steps.actions), len(dataset.steps.observations),
           "/episodes", where)  # fmt: skip
    for name, ids in dataset.slices.items():
        _in_range(ids, len(episodes), f"/slices/{name}", where)
        if (np.diff(ids) <= 0).any():
            raise FormatError(f"/slices/{name} is not ascending", where=where)
    for name, tta in dataset.tta.items():
        _in_range(tta.task, len(dataset.tasks), f"/tta/{name}/episodes/task", where)
        _in_range(tta.goal, len(dataset.goals.dims), f"/tta/{name}/episodes/goal", where)
        _tiles(tta, len(tta.actions), len(tta.observations), f"/tta/{name}/episodes", where)
    if dataset.stats_info:
        seen = np.array(dataset.stats_info.tasks_seen, np.int64)
        _in_range(seen, len(dataset.tasks), "/stats tasks_seen", where)
        # Whoever normalises a test task with its own statistics has looked at the answer.
        leaked = sorted(set(seen.tolist()) - set(dataset.tasks.train_rows))
        if leaked:
            names = ", ".join(dataset.tasks.names[row] for row in leaked)
            raise FormatError("statistics saw test tasks", where=where, found=names)


def check_names(dataset: Dataset) -> None:
    """Names are names: exports build file names of them, and they reach the terminal.

    Raises: FormatError naming the first that leads elsewhere, or that cannot be shown.
    """
    names: dict[str, tuple[str, ...]] = {
        "family": (dataset.family,), "name": (dataset.name,), "version": (dataset.version,),
        "task": dataset.tasks.names, "slice": tuple(dataset.slices), "TTA set": tuple(dataset.tta),
        "policy": dataset.policies.names, "licence": (dataset.license,),
    }  # fmt: skip
    for kind, found in names.items():
        for name in found:
            is_shown_only = kind in ("licence", "policy")
            if what := name_fault(name, is_shown_only):
                raise FormatError(f"the {kind} {what}", where=str(dataset.path), found=ascii(name),
                                  hint="take another copy, or ask whoever made it")  # fmt: skip


def name_fault(name: str, is_shown_only: bool = False) -> str:
    """What keeps `name` from being part of a file name, or from being shown; "" for a good one."""
    if not name.isprintable():
        return "has characters that cannot be shown"
    if len(name) > NAME_LENGTH * (1 + 9 * is_shown_only):
        return f"is longer than {NAME_LENGTH} characters"
    if not is_shown_only and (not name or name.startswith(".") or set("/\\") & set(name)):
        return "is no name: it is empty, begins with a dot or has a slash"
    return ""


def _in_range(rows: NDArray[Any], count: int, name: str, where: str) -> None:
    if len(rows) and not (int(rows.min()) >= 0 and int(rows.max()) < count):
        raise FormatError(f"{name} points outside its table", where=where,
                          expected=f"0 to {count - 1}",
                          found=f"{rows.min()} to {rows.max()}")  # fmt: skip


def _numbers(dataset: Dataset, where: str) -> None:
    """No table holds an infinity; returns and goals are known, where others may be NaN."""
    named: dict[str, Any] = {
        "/episodes/progress": dataset.episodes.progress,
        "/policies/level": dataset.policies.levels,
        "/policies/mix_rate": dataset.policies.mix_rates,
    }  # fmt: skip
    named |= {
        f"/tasks/ref_{kind} of {task}": np.array([one.mean, one.error, one.success or 0.0])
        for task, references in zip(dataset.tasks.names, dataset.tasks.references, strict=True)
        for kind, one in references.by_name.items()
    }  # fmt: skip
    if dataset.stats_info:
        named |= {
            f"/stats/{name}/{key}": values
            for name, columns in dataset.stats_info.fields.items()
            for key, values in columns.items()
        }  # fmt: skip
    known: dict[str, Any] = {
        "/episodes/return": dataset.episodes.returns,
        "/goals/values": dataset.goals.values,
    }
    known |= {f"/tta/{name}/episodes/preset_return": tta.preset_return
              for name, tta in dataset.tta.items()}  # fmt: skip
    wrong = [name for name, values in named.items() if np.isinf(values).any()]
    wrong += [name for name, values in known.items() if not np.isfinite(values).all()]
    if wrong:
        raise FormatError(f"{wrong[0]} holds what is no number", where=where,
                          hint="mpdt-data verify says more; take another copy")  # fmt: skip


def _tiles(columns: Any, num_steps: int, num_observations: int, name: str, where: str) -> None:
    if len(columns.length) and int(columns.length.min()) < 1:
        raise FormatError(f"{name}/length has episodes without a step", where=where)
    total, count = 0, len(columns.length)
    for first in range(0, count, _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        ends = np.cumsum(columns.length[some], dtype=np.int64)
        start = ends - columns.length[some] + total
        obs_start = start + np.arange(first, first + len(start))
        for column, wanted in (("start", start), ("obs_start", obs_start)):
            found = getattr(columns, column)[some]
            if not np.array_equal(found, wanted):
                i = int(np.flatnonzero(found != wanted)[0])
                raise FormatError(f"{name}/{column} leaves a gap or overlaps at episode"
                                  f" {first + i}", where=where, expected=str(wanted[i]),
                                  found=str(found[i]))  # fmt: skip
        total += int(ends[-1])
    for rows, wanted_rows, array in (
        (num_steps, total, "actions"), (num_observations, total + count, "observations"),
    ):  # fmt: skip
        if rows != wanted_rows:
            raise FormatError(f"{name} does not cover the {array}", where=where,
                              expected=f"{wanted_rows} rows", found=f"{rows}")  # fmt: skip
