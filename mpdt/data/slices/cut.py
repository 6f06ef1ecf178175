"""Cut: choose episodes of a file by a rule, and write them to a file of their own.

    file             episode  0 1 2 3 4 5 6 7      task a a a a b b b b
    quality                   r r m m r r m m
    Cut(quality="medium")         2 3     6 7      -> <name>-medium.h5, `source` = 2 3 6 7

The first n episodes of a task are those with the smallest digests: a fixed order that has
nothing to do with how they were made, so 10 are inside 100, and inside all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mpdt.data.slices.choice import first_of_each, in_progress
from mpdt.data.slices.held_out import By, held_out
from mpdt.data.slices.standard import standard_additions
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.inherit import episodes_of, header_of, tta_of
from mpdt.data.store.reader import open_dataset
from mpdt.data.store.tables import Additions, Int64, Stats
from mpdt.data.store.writer import write_file
from mpdt.disk import holding
from mpdt.errors import DataError, FormatError, UsageError, quoted


@dataclass(frozen=True)
class Cut:
    """Which episodes to keep; what is None does not matter.

    Args:
        quality: `random`, `medium`, `expert`, `history` or `policy`.
        tasks: names of tasks of the file.
        role: tasks that are trained on, or tested on; role `both` is in either.
        progress: A and B with A <= progress < B, or <= B where B is 1.
        return_top: this share of each task's episodes, those of the highest return.
        episodes: at most so many per task.
        slice: a named slice of the file.
        validation, by: this share of what training tasks have, see `held_out.py`.
    """

    quality: str | None = None
    tasks: tuple[str, ...] | None = None
    role: Literal["train", "test"] | None = None
    progress: tuple[float, float] | None = None
    return_top: float | None = None
    episodes: int | None = None
    slice: str | None = None
    validation: float | None = None
    by: By | None = None

    def rule(self) -> dict[str, Any]:
        """The conditions as JSON values, for the slice's `rule`."""
        found = {
            "quality": self.quality,
            "tasks": None if self.tasks is None else list(self.tasks),
            "role": self.role,
            "progress": None if self.progress is None else list(self.progress),
            "return_top": self.return_top,
            "episodes": self.episodes,
            "slice": self.slice,
            "validation": self.validation,
            "by": self.by,
        }
        return {name: value for name, value in found.items() if value is not None}

    def suffix(self) -> str:
        """What the file's name gains: `-medium`, `-expert-train-10`."""
        parts = [self.slice, self.quality, self.role]
        if self.tasks:
            few = len(self.tasks) <= 3
            parts.append("+".join(self.tasks) if few else f"{len(self.tasks)}tasks")
        if self.progress is not None:
            parts.append("p{:g}-{:g}".format(*self.progress))
        if self.return_top is not None:
            parts.append(f"top{self.return_top:g}")
        if self.episodes is not None:
            parts.append(str(self.episodes))
        return "".join(f"-{part}" for part in parts if part)


def task_rows(dataset: Dataset, cut: Cut) -> list[int]:
    """Rows of the task table that `cut` allows, ascending. Raises: UsageError for a name."""
    rows = set(range(len(dataset.tasks)))
    if cut.tasks is not None:
        rows &= {dataset.task_row(name) for name in cut.tasks}
    if cut.role is not None:
        tasks = dataset.tasks
        rows &= set(tasks.train_rows if cut.role == "train" else tasks.test_rows)
    return sorted(rows)


def choose(dataset: Dataset, cut: Cut) -> Int64:
    """Ascending absolute ids of the episodes to keep.

    Raises: UsageError for an unknown name, a count below 1 or a range that is none; DataError
        if nothing is left.
    """
    if cut.episodes is not None and not 1 <= cut.episodes < 1 << 31:
        raise UsageError(f"too {'few' if cut.episodes < 1 else 'many'} episodes",
                         where="--episodes", expected="1 or more, and no more than a file has",
                         found=str(cut.episodes))  # fmt: skip
    ids = dataset.select(
        task=[int(row) for row in task_rows(dataset, cut)], quality=cut.quality, slice=cut.slice
    )
    if cut.progress is not None:
        ids = in_progress(dataset, ids, *cut.progress)
    if cut.return_top is not None:
        ids = _best(dataset, ids, cut.return_top)
    if cut.episodes is not None:
        ids = first_of_each(dataset, ids, cut.episodes)
    if cut.validation is not None:
        trained = np.isin(dataset.episodes.task[ids], dataset.tasks.train_rows)
        ids = held_out(dataset, ids[trained], cut.validation, cut.by or "episode")
    if not len(ids):
        raise DataError(
            f"no episode fits {cut.rule()}",
            where=str(dataset.path),
            hint=f"see what there is: mpdt-data show {quoted(dataset.path)}",
        )
    return ids


def _best(dataset: Dataset, ids: Int64, share: float) -> Int64:
    """The share of each task's episodes with the highest return; of equal ones the earlier."""
    if not 0 < share <= 1:
        raise UsageError("not a share", where="--return-top", expected="over 0, at most 1",
                         found=f"{share:g}")  # fmt: skip
    kept: list[int] = []
    for row in np.unique(dataset.episodes.task[ids]):
        mine = ids[dataset.episodes.task[ids] == row]
        order = np.argsort(-dataset.episodes.returns[mine], kind="stable")
        kept += mine[order][: math.ceil(share * len(mine) - 1e-9)].tolist()
    return np.array(sorted(kept), dtype=np.int64)


def cut_file(source: Dataset, cut: Cut, target: Path) -> Dataset:
    """Write the chosen episodes of `source` to `target` and open it.

    Tasks without any episode left go, unless the cut allows them and they have a TTA set:
    adaptation needs nothing else. Statistics are those of the train tasks that remain, or the
    source's where none remains. Reference returns stay what they were.

    Raises: as `choose` and `write_file`; DataError as `refuse_to_replace`.
    """
    step = {"verb": "split", "rule": cut.rule()}
    with holding(target):
        refuse_to_replace([source], target, step)
        return write_cut(source, choose(source, cut), task_rows(source, cut), target, step)


def write_cut(
    source: Dataset, ids: Int64, allowed: Sequence[int], target: Path, step: Mapping[str, Any]
) -> Dataset:
    """Write episodes `ids` of `source` to `target`; see `cut_file`.

    Args:
        allowed: rows of the task table that may stay.
        step: for the lineage: `verb` and rule.
    """
    with_tta = {int(row) for tta in source.tta.values() for row in tta.task}
    with_episodes = {int(row) for row in source.episodes.task[ids]}
    rows = [row for row in allowed if row in with_tta | with_episodes]

    def finish(dataset: Dataset) -> Additions:
        found = standard_additions(dataset)
        return replace(found, stats=found.stats or _inherited_stats(source, rows))

    tta = {name: tta_of(source, name, rows) for name in source.tta}
    return write_file(
        target,
        header_of(source, rows, step),
        episodes_of(source, ids),
        {name: tta_set for name, tta_set in tta.items() if tta_set.num_episodes},
        finish,
    )


def _inherited_stats(source: Dataset, rows: list[int]) -> Stats | None:
    if source.stats_info is None:
        return None
    seen = tuple(rows.index(row) for row in source.stats_info.tasks_seen if row in rows)
    return replace(source.stats_info, slice="", tasks_seen=seen)


def refuse_to_replace(sources: Sequence[Dataset], target: Path, step: Mapping[str, Any]) -> None:
    """What an earlier call made of the same sources by the same rule may be replaced, only that.

    A source that was collected again, under the name it has, counts as the same.

    Args:
        step: what is done to the sources: `verb` and rule.
    Raises: DataError if something else is at `target`.
    """
    if not target.exists():
        return
    try:
        there = open_dataset(target)
        found = f"made by {there.lineage[-1]['verb']}" if there.lineage else "collected or imported"
        if any(target.samefile(source.path) for source in sources):
            found = "the source itself"
        elif _is_same_step(there, sources, step):
            return
        elif there.lineage and there.lineage[-1]["verb"] == step["verb"]:
            found += ", of other sources or by another rule"
    except FormatError as error:
        found = error.what
    raise DataError(
        f"{step['verb']} would replace another file",
        where=str(target),
        expected="nothing, or what the same command made before",
        found=found,
        # Not to delete it: it may be the source, or somebody's only copy.
        hint="choose another name with -o",
    )


def _is_same_step(there: Dataset, sources: Sequence[Dataset], step: Mapping[str, Any]) -> bool:
    if not there.lineage or there.name != sources[0].name:
        return False
    *before, last = there.lineage
    if (last["verb"], last.get("rule")) != (step["verb"], step.get("rule")):
        return False
    if len(sources) > 1:
        return bool(last["from"] == [source.content_hash for source in sources])
    done = [[(one["verb"], one.get("rule")) for one in steps]
            for steps in (before, sources[0].lineage)]  # fmt: skip
    return done[0] == done[1]
