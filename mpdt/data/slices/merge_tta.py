"""The TTA sets of several files as one: for each task the longest of those that begin alike."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

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
    having = [source for source in sources if name in source.tta]
    for source in having[1:]:
        rules = [dict(one.tta[name].rule) for one in (having[0], source)]
        if rules[0] != rules[1]:
            raise _contradiction(name, having[0], source, "rules", f"{rules[0]} and {rules[1]}")
    best: dict[int, tuple[Dataset, int, bytes]] = {}
    for source in having:
        for row, index in enumerate(source.tasks.indices):
            digests = source.tta[name].digest[source.tta[name].task == row].tobytes()
            if not digests:
                continue
            if index in best:
                other, _, known = best[index]
                short, long = sorted((known, digests), key=len)
                if not long.startswith(short):
                    task = source.tasks.names[row]
                    raise _contradiction(name, other, source, "episodes", f"task {task}")
                if len(known) >= len(digests):
                    continue
            best[index] = (source, row, digests)
    parts = [tta_of(best[index][0], name, [best[index][1]]) for index in indices if index in best]

    def episodes() -> Iterator[Episode]:
        for part in parts:
            yield from part.episodes

    return TtaSource(
        episodes(),
        sum(part.num_episodes for part in parts),
        sum(part.num_steps for part in parts),
        {index: value for part in parts for index, value in part.preset_returns.items()},
        having[0].tta[name].rule,
    )


def _contradiction(name: str, one: Dataset, two: Dataset, what: str, found: str) -> DataError:
    return DataError(
        f"the sets tta/{name} have different {what}",
        where=f"{one.path} and {two.path}",
        found=found,
        hint="cut the episodes without the set, or collect both from one entry",
    )
