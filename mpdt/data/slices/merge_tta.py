"""The TTA sets of several files as one: for each task the longest of those that begin alike."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mpdt.data.episode import Episode
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.inherit import tta_of
from mpdt.data.store.sources import TtaSource
from mpdt.errors import DataError


def merged_tta(sources: Sequence[Dataset], indices: Sequence[int]) -> dict[str, TtaSource]:
    """By name of the set; `indices` are the tasks of the new file in their order.

    Raises: DataError where sets of one name have other rules, preset returns or episodes.
    """
    names = sorted({name for source in sources for name in source.tta})
    return {name: _merged(name, sources, indices) for name in names}


def _merged(name: str, sources: Sequence[Dataset], indices: Sequence[int]) -> TtaSource:
    rule, chosen = longest_sets(name, sources)
    parts = [tta_of(sources[number], name, [row]) for number, row in in_order(chosen, indices)]

    def episodes() -> Iterator[Episode]:
        for part in parts:
            yield from part.episodes

    return TtaSource(
        episodes(),
        sum(part.num_episodes for part in parts),
        sum(part.num_steps for part in parts),
        {index: value for part in parts for index, value in part.preset_returns.items()},
        rule,
    )


def longest_sets(
    name: str, sources: Sequence[Dataset]
) -> tuple[Mapping[str, Any], dict[int, tuple[int, int]]]:
    """The rule of the sets of that name, and by task index whose are taken: number of the source
    and row of the task there.

    Raises: DataError where their rules or the episodes of a task contradict each other.
    """
    having = [(number, source) for number, source in enumerate(sources) if name in source.tta]
    first = having[0][1]
    best: dict[int, tuple[int, int]] = {}
    known: dict[int, bytes] = {}
    for number, source in having:
        rules = [dict(one.tta[name].rule) for one in (first, source)]
        if rules[0] != rules[1]:
            raise _contradiction(name, first, source, "rules", f"{rules[0]} and {rules[1]}")
        for row, index in enumerate(source.tasks.indices):
            digests = source.tta[name].digest[source.tta[name].task == row].tobytes()
            if not digests:
                continue
            if index in best:
                short, long = sorted((known[index], digests), key=len)
                if not long.startswith(short):
                    task, other = source.tasks.names[row], sources[best[index][0]]
                    raise _contradiction(name, other, source, "episodes", f"task {task}")
                if len(known[index]) >= len(digests):
                    continue
            best[index], known[index] = (number, row), digests
    return first.tta[name].rule, best


def in_order(
    chosen: Mapping[int, tuple[int, int]], indices: Sequence[int]
) -> list[tuple[int, int]]:
    """Of `longest_sets`, in the order of the tasks of the new file."""
    return [chosen[index] for index in indices if index in chosen]


def _contradiction(name: str, one: Dataset, two: Dataset, what: str, found: str) -> DataError:
    return DataError(
        f"the sets tta/{name} have different {what}",
        where=f"{one.path} and {two.path}",
        found=found,
        hint="cut the episodes without the set, or collect both from one entry",
    )
