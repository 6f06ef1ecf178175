"""The slices every file has: one per quality, the episodes of train and of test tasks, and the
published quality levels where the data has a history to cut them from.

    history     |---- 0.30 ----|  0.35 ---- 0.65  |  0.70 ---- 1|
                 paper-random     paper-medium     paper-expert
    paper-mixed  the three in equal parts, per task

Source: the rule the paper's authors gave in their rebuttal: of each task's trajectories in the
order of training the first 30 % are random, the middle 30 % medium, the last 30 % expert.
"""

from __future__ import annotations

import numpy as np

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.slices.choice import first_of_each, in_progress
from mpdt.data.slices.stats import compute_stats
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.tables import Additions, Slice

PAPER_LEVELS = {
    "paper-random": (0.0, 0.3),
    "paper-medium": (0.35, 0.65),
    "paper-expert": (0.7, 1.0),
}
PAPER_MIXED = "paper-mixed"


def standard_additions(dataset: Dataset) -> Additions:
    """What every file of ours gets: its slices, and statistics where a training task has episodes.

    They are only found out once the episodes are in the file, hence as the writer's `finish`.
    """
    trained = set(dataset.episodes.task.tolist()) & set(dataset.tasks.train_rows)
    return Additions(standard_slices(dataset), compute_stats(dataset) if trained else None)


def standard_slices(dataset: Dataset) -> dict[str, Slice]:
    """Slices by name; empty ones are left out. Tasks of role `both` are in train and test.

    quality   random, medium, expert, history, policy
    role      train, test
    history   paper-random, paper-medium, paper-expert, paper-mixed
    """
    slices = {}
    for quality in QUALITY_CODES:
        ids = dataset.select(quality=quality)
        if len(ids):
            slices[quality] = Slice(ids, {"quality": quality})
    roles = {"train": dataset.tasks.train_rows, "test": dataset.tasks.test_rows}
    for role, rows in roles.items():
        ids = np.flatnonzero(np.isin(dataset.episodes.task, rows)).astype(np.int64)
        if len(ids):
            slices[role] = Slice(ids, {"role": role})
    return slices | _paper_slices(dataset)


def _paper_slices(dataset: Dataset) -> dict[str, Slice]:
    history = dataset.select(quality="history")
    levels = {name: in_progress(dataset, history, *span) for name, span in PAPER_LEVELS.items()}
    slices = {
        name: Slice(ids, {"quality": "history", "progress": list(PAPER_LEVELS[name])})
        for name, ids in levels.items()
        if len(ids)
    }
    parts = []
    for row in range(len(dataset.tasks)):
        mine = [ids[dataset.episodes.task[ids] == row] for ids in levels.values()]
        count = min(map(len, mine))
        parts += [first_of_each(dataset, ids, count) for ids in mine if count]
    if parts:
        rule = {"equal_parts": list(PAPER_LEVELS)}
        slices[PAPER_MIXED] = Slice(np.sort(np.concatenate(parts)), rule)
    return slices
