"""Selection: the episodes of a file that are exported, and what the export says about itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mpdt.data.episode import Episode
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.digest import content_hash
from mpdt.data.store.inherit import header_of, task_rows
from mpdt.data.store.proof import proven
from mpdt.data.store.sources import FileHeader
from mpdt.data.store.tables import Int64, TaskRow


@dataclass(frozen=True, eq=False)
class Run:
    """The selected episodes of one task and quality, in canonical order."""

    task: TaskRow
    quality: int
    ids: Int64


@dataclass(frozen=True, eq=False)
class Selection:
    """Ascending absolute episode ids of a file.

    Args:
        ids: at least one.
        slice: name of the slice they are; "" for all episodes.
    """

    dataset: Dataset
    ids: Int64
    slice: str = ""

    @property
    def is_whole(self) -> bool:
        return len(self.ids) == self.dataset.num_episodes

    @cached_property
    def header(self) -> FileHeader:
        """Header of a file with these episodes alone; tasks without any of them go.

        Of a whole file everything stays, also where it was cut out of.
        """
        if self.is_whole:
            return replace(header_of(self.dataset), parent=self.dataset.parent)
        rows = np.unique(self.dataset.episodes.task[self.ids]).tolist()
        return header_of(self.dataset, rows, {"verb": "export", "rule": {"slice": self.slice}})

    @cached_property
    def content_hash(self) -> str:
        """Content hash of a file with these episodes alone."""
        return content_hash(self.header.content(), self.dataset.episodes.digest[self.ids])

    @cached_property
    def source_ids(self) -> list[int] | None:
        """Ids in the file that `header.parent` names."""
        if not self.is_whole:
            return [int(i) for i in self.ids]
        source = self.dataset.episodes.source
        return None if source is None else [int(i) for i in source]

    @property
    def num_steps(self) -> int:
        return int(self.dataset.episodes.length[self.ids].sum())

    def episode(self, episode_id: int) -> Episode:
        """One episode, compared with its digest: an export must not pass on damage.

        Raises: FormatError.
        """
        return proven(self.dataset, episode_id)

    def runs(self) -> Iterator[Run]:
        """One (task, quality) after the other."""
        episodes, rows = self.dataset.episodes, task_rows(self.dataset)
        for row in np.unique(episodes.task[self.ids]).tolist():
            mine = self.ids[episodes.task[self.ids] == row]
            for quality in np.unique(episodes.quality[mine]).tolist():
                yield Run(rows[row], quality, mine[episodes.quality[mine] == quality])
