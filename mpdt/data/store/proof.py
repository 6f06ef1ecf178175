"""Proof: episodes have the bytes that their digests say, wherever they are copied or trained on.

    copied      `proven`, episode by episode: what is compared is what is written
    amended     `check_digests`, the whole file while it is copied
    trained on  `BackgroundProof`, beside the first updates, at the price of reading once

Without it damage would get a new digest in the copy, and would be the truth from then on.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.episode import Episode
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.digest import episode_digest
from mpdt.data.store.digests import Labels, array_digests
from mpdt.data.store.origin import damaged_hint
from mpdt.data.store.reader import open_tta_rewards
from mpdt.data.store.tables import Int64
from mpdt.data.store.ttaset import tta_episodes, unlabelled
from mpdt.data.workers.threads import in_order
from mpdt.errors import FormatError, MpdtError, quoted

CHECKED_AT_ONCE = 4096  # episodes
_ARRAYS = ("observations", "actions", "rewards", "terminations", "truncations")


def proven(dataset: Dataset, episode_id: int) -> Episode:
    """One episode as a copy in memory whose bytes are those of its digest.

    Raises: UsageError for an id outside the file; FormatError for other bytes.
    """
    episode = _in_memory(dataset.episode(episode_id))
    name = dataset.tasks.names[int(dataset.episodes.task[episode_id])]
    if episode_digest(episode, name) != dataset.episodes.digest[episode_id].tobytes():
        raise _damaged(dataset, [int(episode_id)])
    return episode


def proven_tta(dataset: Dataset, name: str) -> Iterator[Episode]:
    """The episodes of a TTA set with the simulator's rewards, compared as `proven` does.

    Raises: as `open_tta_rewards`; FormatError for other bytes.
    """
    tta, labels = dataset.tta[name], dataset.tasks.names
    for i, episode in enumerate(tta_episodes(dataset, name, *open_tta_rewards(dataset, name))):
        copy = _in_memory(episode)
        if episode_digest(unlabelled(copy), labels[int(tta.task[i])]) != tta.digest[i].tobytes():
            raise _damaged(dataset, [i], name)
        yield copy


def _in_memory(episode: Episode) -> Episode:
    return replace(
        episode,
        observations=np.array(episode.observations),
        actions=np.array(episode.actions),
        rewards=np.array(episode.rewards),
        terminations=np.array(episode.terminations),
        truncations=np.array(episode.truncations),
        successes=None if episode.successes is None else np.array(episode.successes),
    )


def check_digests(
    dataset: Dataset,
    where: Path | None = None,
    sets: Iterable[str] = (),
    ids: Int64 | None = None,
    hint: str = "",
) -> None:
    """Recompute digests from the file's own bytes.

    Args:
        where: what the error is about; None = the file.
        sets: TTA sets to look at too.
        ids: ascending; None = all episodes.
        hint: instead of leaving the episodes out.
    Raises: FormatError naming the first three episodes that differ.
    """
    for name, wrong in differing(dataset, sets, ids, threads=0):
        raise _damaged(dataset, wrong, name, where, hint)


def differing(
    dataset: Dataset,
    sets: Iterable[str],
    ids: Int64 | None = None,
    stop: Callable[[], bool] = lambda: False,
    threads: int = 1,
) -> Iterator[tuple[str, list[int]]]:
    """Episodes that do not have their digest, some thousands at a time: ("", ids) for the file's
    own, (name of the set, ids) for a TTA set's.

    Args:
        threads: as `in_order`; beside other work of this process one.
    """
    table, steps, labels = dataset.episodes, dataset.steps, Labels(dataset)
    names = [*_ARRAYS, *(["successes"] if steps.successes is not None else [])]
    own = [(name, getattr(steps, name)) for name in names]
    every = np.arange(dataset.num_episodes) if ids is None else ids

    def look(chunk: range) -> list[int]:
        return _wrong(own, table, chunk, [labels.episode(i) for i in chunk])

    for wrong in in_order(look, _until(stop, _chunks(every)), threads):
        if wrong:
            yield "", wrong
    for name in sets:
        tta, (rewards, successes) = dataset.tta[name], open_tta_rewards(dataset, name, False)
        arrays: list[tuple[str, NDArray[Any]]] = [
            ("observations", tta.observations), ("actions", tta.actions), ("rewards", rewards),
            ("terminations", tta.terminations), ("truncations", tta.truncations),
            *([] if successes is None else [("successes", successes)]),
        ]  # fmt: skip
        for chunk in _chunks(np.arange(len(tta))):
            if wrong := _wrong(arrays, tta, chunk, [labels.tta(tta, i) for i in chunk]):
                yield name, wrong


def _until(stop: Callable[[], bool], chunks: Iterator[range]) -> Iterator[range]:
    for chunk in chunks:
        if stop():
            return
        yield chunk


def _chunks(ids: NDArray[np.int64]) -> Iterator[range]:
    """Runs of neighbours, which lie side by side in the arrays."""
    ends = np.flatnonzero(np.diff(ids) != 1) + 1
    for first, last in zip([0, *ends], [*ends, len(ids)], strict=True):
        for start in range(int(first), int(last), CHECKED_AT_ONCE):
            stop = min(start + CHECKED_AT_ONCE, int(last))
            yield range(int(ids[start]), int(ids[stop - 1]) + 1)


def _wrong(
    arrays: Sequence[tuple[str, NDArray[Any]]], table: Any, chunk: range, labels: Sequence[bytes]
) -> list[int]:
    first, last = chunk[0], chunk[-1]
    length = int(table.length[last])
    rows = slice(int(table.start[first]), int(table.start[last]) + length)
    seen = slice(int(table.obs_start[first]), int(table.obs_start[last]) + length + 1)
    views = [(name, array[seen if name == "observations" else rows]) for name, array in arrays]
    digests = array_digests(views, table.length[first : chunk.stop].tolist(), labels)
    found = np.frombuffer(digests, np.uint8).reshape(-1, 32)
    away = (found != table.digest[first : chunk.stop]).any(axis=1)
    return (np.flatnonzero(away) + first).tolist()


def _damaged(
    dataset: Dataset,
    wrong: Sequence[int],
    tta: str = "",
    where: Path | None = None,
    hint: str = "",
) -> FormatError:
    path = where or dataset.path
    one = len(wrong) == 1
    ids = ", ".join(map(str, wrong[:3])) + (f" and {len(wrong) - 3} more" if wrong[3:] else "")
    of = f" of the TTA set '{tta}'" if tta else ""
    does = "does not have the bytes of its digest" if one else "do not have their digests' bytes"
    leave_out = f"mpdt-data drop {quoted(path)} --episodes {quoted(','.join(map(str, wrong)))}"
    again = damaged_hint(path, dataset)
    return FormatError(
        f"{'episode' if one else 'episodes'} {ids}{of} {does}",
        where=str(path),
        hint=hint
        or (again if tta else f"leave out what is damaged: {leave_out} -o OUT.h5; {again}"),
    )


class BackgroundProof:
    """Compares the episodes that a training reads with their digests, in a thread of its own.

    Usage: `check()` now and then, `finish()` before anything is kept that was made of them.

    Args:
        ids: absolute ids, ascending.
        sets: TTA sets that are read too.
    """

    def __init__(self, dataset: Dataset, ids: Int64, sets: Iterable[str] = ()) -> None:
        self._dataset, self._ids = dataset, ids
        self._sets = tuple(sets)
        self._error: MpdtError | None = None
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._look, name="proof", daemon=True)
        self._thread.start()

    def _look(self) -> None:
        try:
            for part, ids in self._dataset.in_files(self._ids):
                sets = [name for name in self._sets if name in part.tta]
                for name, wrong in differing(part, sets, ids, self._stopped.is_set):
                    raise _damaged(part, wrong, name)
        except MpdtError as error:
            self._error = error
        except (OSError, ValueError) as error:  # a map of a file that became shorter ends us
            self._error = FormatError("could not be compared with its digests",
                                      where=str(self._dataset.path),
                                      found=str(error))  # fmt: skip

    def check(self) -> None:
        """Raises: FormatError naming the episodes, if some were found by now."""
        if self._error is not None:
            raise self._error

    def finish(self) -> None:
        """Wait for the rest. Raises: as `check`."""
        self._thread.join()
        self.check()

    def stop(self) -> None:
        """Look no further."""
        self._stopped.set()
        self._thread.join()
