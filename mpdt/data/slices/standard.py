"""The slices every file has: one per quality, and the episodes of train and of test tasks."""

from __future__ import annotations

import numpy as np

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.tables import Slice


def standard_slices(dataset: Dataset) -> dict[str, Slice]:
    """Slices by name; empty ones are left out. Tasks of role `both` are in train and test.

    quality   random, medium, expert, history
    role      train, test
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
    return slices
