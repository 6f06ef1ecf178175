"""Held out: a share of what training tasks have, to compare policies on without the simulator.

    by episode   of each task and quality a share of its episodes
    by goal      of each task a share of its goals, with all their episodes
    by task      a share of the tasks, with all their episodes

Tasks that are only tested on are never touched. What is chosen depends on names, goals and digests
alone, so nobody has drawn it. By episode it is the end of the order whose beginning `--episodes`
takes: 10 episodes of a task hold none of its validation.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from mpdt.data.store.dataset import Dataset
from mpdt.data.store.tables import Int64
from mpdt.errors import DataError, UsageError, unknown_name

Flags = NDArray[np.bool_]
By = Literal["episode", "goal", "task"]
_ALONE = {"episode": "no task has two episodes of a quality", "goal": "every task has one goal",
          "task": "one task has all the episodes"}  # fmt: skip


def held_out(dataset: Dataset, ids: Int64, share: float, by: By = "episode") -> Int64:
    """Those of `ids` (ascending, of training tasks) that are kept from training.

    Of n groups at least one and at most n - 1, rounded to the nearest; of one group none.

    Raises: UsageError for a share that is none or an unknown `by`; DataError where nothing could be
        held out, or nothing would be left.
    """
    if not 0 < share < 1:
        raise UsageError("not a share", where="--validation", expected="over 0, below 1",
                         found=f"{share:g}")  # fmt: skip
    if by not in get_args(By):
        raise unknown_name("way to hold out", by, get_args(By), where="--by")
    episodes = dataset.episodes
    task = episodes.task[ids]
    if by == "task":
        rows = np.unique(task)
        names = (dataset.tasks.names[row].encode() for row in rows)
        chosen = _share(rows, [hashlib.sha256(name).hexdigest() for name in names], share)
        kept = np.isin(task, chosen)
    else:
        kept = np.zeros(len(ids), bool)
        for row in np.unique(task):
            kept |= _of_task(dataset, ids, task == row, share, by)
    if not kept.any():
        raise DataError(f"nothing to hold out: {_ALONE[by]}", where=str(dataset.path),
                        hint=f"--by {' or --by '.join(sorted(set(get_args(By)) - {by}))}"
                        )  # fmt: skip
    return np.asarray(ids[kept])


def _of_task(
    dataset: Dataset, ids: Int64, mine: Flags, share: float, by: By
) -> Flags:  # fmt: skip
    """Which of `ids` are held out of the task whose episodes `mine` are."""
    episodes, kept = dataset.episodes, np.zeros(len(ids), bool)
    if by == "goal":
        goals = np.unique(episodes.goal[ids[mine]])
        order = [hashlib.sha256(dataset.goals.of(goal).tobytes()).hexdigest() for goal in goals]
        return mine & np.isin(episodes.goal[ids], _share(goals, order, share))
    for quality in np.unique(episodes.quality[ids[mine]]):
        places = np.flatnonzero(mine & (episodes.quality[ids] == quality))
        order = [episodes.digest[i].tobytes().hex() for i in ids[places]]
        kept[_share(places, order, share)] = True
    return kept


def _share(groups: NDArray[Any], order: Sequence[str], share: float) -> list[int]:
    """The last of `groups` in that order."""
    count = min(max(1, round(share * len(groups))), len(groups) - 1)
    ordered = sorted(zip(order, groups.tolist(), strict=True))
    return [group for _, group in ordered[len(ordered) - count :]]
