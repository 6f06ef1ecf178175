"""What a notebook shows of a data set and of its slices: tables in HTML, `_repr_html_`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.store.tables import Int64
from mpdt.draw.table import Table, html_table

if TYPE_CHECKING:
    from mpdt.data.store.dataset import Dataset

MOST_TASKS = 50
ROLES = ("train", "test", "both")


class Slices(dict[str, Int64]):
    """Name -> ascending absolute episode ids; a notebook shows them with their rules."""

    def __init__(self, ids: Mapping[str, Int64], rules: Mapping[str, Mapping[str, Any]]) -> None:
        super().__init__(ids)
        self.rules = rules

    def __reduce__(self) -> tuple[Any, ...]:
        return Slices, (dict(self), self.rules)

    def _repr_html_(self) -> str:
        rows = [
            (name, " ".join(f"{k}={v}" for k, v in self.rules[name].items()), f"{len(ids):,}")
            for name, ids in self.items()
        ]
        return html_table(Table("slices", ("slice", "rule", "episodes"), tuple(rows)))


def dataset_html(data: Dataset) -> str:
    """Name, counts and hash; per task the mean return of each quality, of the first 50 tasks."""
    episodes, tasks = data.episodes, data.tasks
    codes = {name: code for name, code in QUALITY_CODES.items() if (episodes.quality == code).any()}
    rows = []
    for row, name in list(enumerate(tasks.names))[:MOST_TASKS]:
        own = episodes.task == row
        found = [own & (episodes.quality == code) for code in codes.values()]
        means = [f"{episodes.returns[one].mean():,.1f}" if one.any() else "-" for one in found]
        rows.append((name, ROLES[int(tasks.roles[row])], f"{np.count_nonzero(own):,}", *means))
    title = (
        f"{data.name} {data.version}: {data.num_episodes:,} episodes, {data.num_steps:,} steps, "
        f"content {data.content_hash[:8]}"
    )
    notes = [f"mean returns; file {data.title}"]
    if more := len(tasks.names) - len(rows):
        notes.append(f"and {more:,} tasks more")
    if data.slices:
        notes.append("slices: " + ", ".join(data.slices))
    if data.tta:
        notes.append(
            "sets to adapt on: " + ", ".join(f"{k} ({len(v)})" for k, v in data.tta.items())
        )
    return html_table(Table(title, ("task", "role", "episodes", *codes), tuple(rows), tuple(notes)))
