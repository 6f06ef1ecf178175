"""Dataset: an open file as tables in RAM and step arrays mapped from disk."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import index
from pathlib import Path
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from mpdt.data.episode import QUALITY_CODES, Episode, PolicyInfo
from mpdt.data.spec.family import Family
from mpdt.data.spec.own import family_of
from mpdt.data.store.digest import content_header
from mpdt.data.store.opening import Source
from mpdt.data.store.shown import dataset_html
from mpdt.data.store.tables import (
    Episodes,
    Float64,
    Goals,
    Int64,
    Policies,
    Stats,
    Steps,
    Tasks,
    TtaSet,
)
from mpdt.errors import UsageError, unknown_name


@dataclass(frozen=True, eq=False)
class Dataset:
    """Everything a training run may read of a file. Holds no HDF5 object.

    It keeps its data when the path is replaced, and may be used after a fork. A pickle of it holds
    the path and what is in the file, and maps the file again where it is loaded.

    Args:
        source: the file itself, which is read on even if another one has its path by now.
        spec: the datasets.yaml entry that made it; `spec_hash` its SHA-256.
        content_hash: identity of the episodes, whatever the slices, stats or packages.
        parent: content hash of the file it was cut out of, or "".
        lineage: every step since the data was collected, oldest first: `verb`, what it was made
            `from` (content hashes) and the rule.
        slices: name -> ascending absolute episode ids; `slice_rules` how they were made.
        stats_info: `fields` of it, field -> statistic -> float64 array, is `stats`, empty before
            any were computed; it also holds which slice and tasks they saw.
        tta: name -> unlabelled episodes; their simulated rewards are not reachable from here.
    """

    path: Path
    source: Source = field(repr=False)
    family: str
    name: str
    version: str
    license: str
    spec: Mapping[str, Any] = field(repr=False)
    spec_hash: str
    content_hash: str
    parent: str
    packages: Mapping[str, str] = field(repr=False)
    platform: Mapping[str, str] = field(repr=False)
    tasks: Tasks = field(repr=False)
    goals: Goals = field(repr=False)
    policies: Policies = field(repr=False)
    episodes: Episodes = field(repr=False)
    steps: Steps = field(repr=False)
    slices: Mapping[str, Int64] = field(repr=False)
    slice_rules: Mapping[str, Mapping[str, Any]] = field(repr=False)
    stats_info: Stats | None = field(repr=False)
    tta: Mapping[str, TtaSet] = field(repr=False)
    lineage: Sequence[Mapping[str, Any]] = field(default=(), repr=False)
    definition: Mapping[str, Any] = field(default_factory=dict, repr=False)
    """Of one's own family, see `spec.family.definition`; empty for those that mpdt ships."""
    seal: str = field(default="", repr=False)
    """Of all that the content hash does not cover."""

    parts: Sequence[Dataset] = field(default=(), repr=False)
    """The files that are read as this one, see `slices/join.py`; none where it is a file itself."""

    @property
    def title(self) -> str:
        """Name of the file without its folder, or of each."""
        return ",".join(part.title for part in self.parts) or self.path.name

    @property
    def num_bytes(self) -> int:
        """On the disk."""
        return sum(part.num_bytes for part in self.parts) or self.path.stat().st_size

    def in_files(self, ids: Int64) -> list[tuple[Dataset, Int64]]:
        """Where these episodes are: each file that holds some, and their ids there, ascending."""
        return [(self, ids)]

    def tta_in_files(self, name: str) -> list[tuple[Dataset, Int64]]:
        """Where the episodes of a TTA set are: a file and ids of its set of that name, in order."""
        return [(self, np.arange(len(self.tta[name])))]

    @property
    def stats(self) -> Mapping[str, Mapping[str, Float64]]:
        return self.stats_info.fields if self.stats_info else {}

    @property
    def num_episodes(self) -> int:
        return len(self.episodes)

    @property
    def num_steps(self) -> int:
        return len(self.steps.rewards)

    @property
    def observation_size(self) -> int:
        return int(self.steps.observations.shape[1])

    @property
    def action_size(self) -> int:
        return int(self.steps.actions.shape[1])

    def contract(self) -> Family:
        """Its family: the one known here, or, without a simulator, what the file says of it.

        Raises: UsageError for a family that neither knows; DataError where they disagree.
        """
        return family_of(self.family, self.definition)

    def _repr_html_(self) -> str:
        return dataset_html(self)

    def content_header(self) -> dict[str, Any]:
        """What the content hash knows of this file beside its episodes."""
        return content_header(
            self.family, self.tasks.names, self.observation_size, self.action_size,
            self.steps.successes is not None,
        )  # fmt: skip

    def __reduce__(self) -> tuple[Any, ...]:
        from mpdt.data.store.reader import open_again

        is_mapped = isinstance(self.steps.observations, np.memmap)
        return open_again, (self.source.path, self.content_hash, self.seal, not is_mapped)

    def task_row(self, name_or_row: str | SupportsIndex) -> int:
        """Row of the task table.

        Raises: UsageError naming the nearest task of the file; TypeError for neither a name nor a
        whole number.
        """
        if isinstance(name_or_row, str):
            if name_or_row in self.tasks.names:
                return self.tasks.names.index(name_or_row)
        elif 0 <= (row := index(name_or_row)) < len(self.tasks):
            return row
        raise unknown_name("task", str(name_or_row), self.tasks.names, where=str(self.path))

    def episode(self, episode_id: SupportsIndex) -> Episode:
        """One episode; its arrays are views of the file.

        Raises: UsageError for an id outside the file.
        """
        columns, i = self.episodes, index(episode_id)
        if not 0 <= i < len(columns):
            raise UsageError(f"no episode {i}", where=str(self.path),
                             expected=f"0 to {len(columns) - 1}")  # fmt: skip
        return self.steps.episode(
            int(columns.start[i]),
            int(columns.obs_start[i]),
            int(columns.length[i]),
            columns.seed_key[i],
            task=self.tasks.indices[columns.task[i]],
            goal=self.goals.of(int(columns.goal[i])),
            quality=int(columns.quality[i]),
            progress=float(columns.progress[i]),
            policy=self.policies.hashes[columns.policy[i]].tobytes(),
        )

    def policy_infos(self) -> list[PolicyInfo]:
        """The policy table as the writer takes it."""
        table = self.policies
        return [
            PolicyInfo(
                hash=table.hashes[row].tobytes(),
                task=self.tasks.indices[table.tasks[row]],
                rung=int(table.rungs[row]),
                level=float(table.levels[row]),
                train_step=int(table.train_steps[row]),
                mix_rate=float(table.mix_rates[row]),
                name=table.names[row],
            )
            for row in range(len(table.names))
        ]

    def select(
        self,
        task: str | SupportsIndex | Iterable[str | SupportsIndex] | None = None,
        quality: str | Sequence[str] | None = None,
        slice: str | None = None,
    ) -> Int64:
        """Ascending absolute ids of the episodes that fit all given conditions.

        Args:
            task: name or row of the task table, or several.
            quality: `random`, `medium`, `expert`, `history`, `policy`, `unknown`, or several.
            slice: name of a stored slice.
        Raises: UsageError naming the nearest known task, quality or slice.
        """
        fits = np.ones(len(self.episodes), np.bool_)
        if slice is not None:
            if slice not in self.slices:
                raise unknown_name("slice", slice, self.slices, where=str(self.path))
            fits[:] = False
            fits[self.slices[slice]] = True
        if task is not None:
            fits &= _is_one_of(self.episodes.task, [self.task_row(one) for one in _several(task)])
        if quality is not None:
            names = [quality] if isinstance(quality, str) else list(quality)
            known = QUALITY_CODES | {"unknown": -1}
            for name in names:
                if name not in known:
                    raise unknown_name("quality", name, known, where=str(self.path))
            fits &= _is_one_of(self.episodes.quality, [known[name] for name in names])
        return np.flatnonzero(fits)


def _is_one_of(column: NDArray[Any], numbers: Sequence[int]) -> NDArray[np.bool_]:
    """One pass for one number, which is what every task of a training asks for."""
    return column == numbers[0] if len(numbers) == 1 else np.isin(column, numbers)


def _several(task: str | SupportsIndex | Iterable[Any]) -> list[Any]:
    """One or several, as several; an array of one number is a list, a number of numpy is not."""
    if isinstance(task, str):
        return [task]
    try:
        return [index(task)]  # type: ignore[arg-type]
    except TypeError:
        return list(task)  # type: ignore[arg-type]
