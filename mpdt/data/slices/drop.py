"""Drop: all episodes of a file but some, in a new file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mpdt.data.slices.cut import Cut, choose, refuse_to_replace, write_cut
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.tables import Int64
from mpdt.disk import holding
from mpdt.errors import DataError, UsageError

_LONGEST = 100_000_000
_LISTED = 1000  # ids that the lineage names; more are only counted


def parse_ids(words: Sequence[str]) -> list[int]:
    """`3,17 40-49` as episode ids, each once, ascending. Raises: UsageError."""
    ids: set[int] = set()
    for word in (part for text in words for part in text.split(",") if part):
        match = re.fullmatch(r"(\d+)(?:-(\d+))?", word)
        if match is None:
            raise UsageError("cannot read the episodes", where="--episodes",
                             expected="ids such as 3,17,40-49", found=word)  # fmt: skip
        first, last = int(match[1]), int(match[2] or match[1])
        if last < first:
            raise UsageError("a range runs upwards", where="--episodes", found=word)
        if last - first > _LONGEST:
            raise UsageError("a range longer than any file", where="--episodes", found=word)
        ids.update(range(first, last + 1))
    return sorted(ids)


def drop(
    source: Dataset, target: Path, ids: Sequence[int] = (), rule: Cut | None = None
) -> Dataset:
    """Write `source` without some episodes to `target` and open it.

    The others keep their bytes and order; `source` in the new file holds their ids in the old.
    TTA sets stay whole.

    Args:
        ids: absolute ids to leave out.
        rule: leave out what it chooses; together with `ids`, both.
    Raises: UsageError for no ids, ids outside the file, or an unknown name in `rule`;
        DataError where nothing would be left, or as `refuse_to_replace`; StorageError.
    """
    gone: set[int] = set(ids)
    if outside := sorted(i for i in gone if not 0 <= i < source.num_episodes):
        raise UsageError(f"no episode {outside[0]}", where=str(source.path),
                         expected=f"0 to {source.num_episodes - 1}")  # fmt: skip
    said: dict[str, object] = {}
    if gone:
        said["episodes"] = sorted(gone) if len(gone) <= _LISTED else len(gone)
    if rule is not None and rule.rule():
        said |= {"chosen": rule.rule()}
        gone |= set(choose(source, rule).tolist())
    if not gone:
        raise UsageError("nothing to drop", hint="give --episodes, --tasks or --quality")
    kept: Int64 = np.array([i for i in range(source.num_episodes) if i not in gone], np.int64)
    if not len(kept):
        raise DataError("no episode would be left", where=str(source.path))
    step = {"verb": "drop", "rule": said}
    with holding(target):
        refuse_to_replace([source], target, step)
        return write_cut(source, kept, range(len(source.tasks)), target, step)
