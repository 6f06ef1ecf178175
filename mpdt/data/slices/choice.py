"""Choice: which episodes of a list belong to a range of progress, or are the first few."""

from __future__ import annotations

import numpy as np

from mpdt.data.store.dataset import Dataset
from mpdt.data.store.tables import Int64
from mpdt.errors import UsageError


def parse_progress(text: str) -> tuple[float, float]:
    """`0.35:0.65` as two numbers; an empty side is the end of the ladder. Raises: UsageError."""
    low, colon, high = text.partition(":")
    try:
        if colon:
            return float(low or 0), float(high or 1)
    except ValueError:
        pass
    raise UsageError("cannot read the range", where="--progress", expected="A:B, such as 0.35:0.65",
                     found=text)  # fmt: skip


def in_progress(dataset: Dataset, ids: Int64, low: float, high: float) -> Int64:
    """Those of `ids` with low <= progress < high, or <= 1 where `high` is 1.

    Progress is stored as float32, where 0.7 is a little less than 0.7: six digits count.

    Raises: UsageError unless 0 <= low < high <= 1.
    """
    if not 0 <= low < high <= 1:
        raise UsageError("not a range of progress", where="--progress",
                         expected="A:B, 0 <= A < B <= 1", found=f"{low:g}:{high:g}")  # fmt: skip
    progress = np.round(dataset.episodes.progress[ids].astype(np.float64), 6)
    inside = (progress >= low) & ((progress < high) | ((high == 1) & (progress == 1)))
    return np.asarray(ids[inside])


def first_of_each(dataset: Dataset, ids: Int64, count: int) -> Int64:
    """At most `count` of `ids` per task: those with the smallest digests, so 10 are inside 100."""
    digests, tasks = dataset.episodes.digest, dataset.episodes.task
    kept: list[int] = []
    for row in np.unique(tasks[ids]):
        mine = ids[tasks[ids] == row]
        kept += sorted(mine.tolist(), key=lambda i: digests[i].tobytes())[:count]
    return np.array(sorted(kept), dtype=np.int64)
