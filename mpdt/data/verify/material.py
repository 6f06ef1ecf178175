"""Material: an opened file as the checks look at it, in pieces that fit a processor cache.

    Track    the file's own episodes, or a TTA set: tables and step arrays with their lengths
    Chunk    consecutive episodes of a track, a few megabytes, as views of the map

A file of any size passes once, chunk by chunk, through all checks that look at steps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mpdt.data.spec.family import Family
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.opening import opened
from mpdt.data.store.reader import open_tta_rewards
from mpdt.data.store.tables import Bool, Episodes, Float32, Int64, TtaSet
from mpdt.errors import MpdtError
from mpdt.seeding import UNKNOWN_SEED_KEY

CHUNK_BYTES = 4 << 20


@dataclass(frozen=True, eq=False)
class Chunk:
    """Episodes `first` to `last - 1`; `starts` (n,) and `obs_starts` (n,) count from the views.

    Shapes: observations (steps + n, D), everything else (steps, ...); lengths (n,).
    """

    first: int
    last: int
    starts: Int64
    obs_starts: Int64
    lengths: Int64
    observations: Float32
    actions: Float32
    rewards: Float32
    terminations: Bool
    truncations: Bool
    successes: Bool | None

    def episodes_of(self, rows: Any, starts: Int64 | None = None) -> list[int]:
        """Absolute ids of the episodes that own these rows of the views, ascending."""
        found = np.searchsorted(self.starts if starts is None else starts, rows, side="right") - 1
        return (np.unique(found) + self.first).tolist()  # type: ignore[no-any-return]


@dataclass(frozen=True, eq=False)
class Track:
    """One table of episodes with its step arrays; `label` is empty for the file's own."""

    label: str
    table: Episodes | TtaSet
    observations: Float32
    actions: Float32
    rewards: Float32
    terminations: Bool
    truncations: Bool
    successes: Bool | None
    horizon: int | None
    """Steps after which an episode is truncated; None where nobody said."""

    def __len__(self) -> int:
        return len(self.table)

    def chunks(self, size_bytes: int = CHUNK_BYTES) -> Iterator[Chunk]:
        """All episodes in order, about `size_bytes` of observations at a time.

        Only for tracks whose offsets tile the arrays (`shapes` passed).
        """
        row_bytes = 4 * max(1, self.observations.shape[1] + self.actions.shape[1])
        lengths = self.table.length.astype(np.int64)
        ends = np.cumsum(lengths)
        first = 0
        while first < len(lengths):
            begin = int(ends[first] - lengths[first])
            last = int(np.searchsorted(ends, begin + size_bytes // row_bytes, side="right"))
            last = max(last, first + 1)
            steps = slice(begin, int(ends[last - 1]))
            rows = slice(begin + first, int(ends[last - 1]) + last)
            starts = ends[first:last] - lengths[first:last] - begin
            yield Chunk(
                first=first,
                last=last,
                starts=starts,
                obs_starts=starts + np.arange(last - first),
                lengths=lengths[first:last],
                observations=self.observations[rows],
                actions=self.actions[steps],
                rewards=self.rewards[steps],
                terminations=self.terminations[steps],
                truncations=self.truncations[steps],
                successes=None if self.successes is None else self.successes[steps],
            )
            first = last


@dataclass(frozen=True, eq=False)
class Material:
    """The file, and what only `verify` reads of it.

    Args:
        sim: TTA set -> what the simulator said: rewards (N,), successes (N,) or None.
        slice_parents: slice -> content hash of the file it was made for.
    """

    path: Path
    dataset: Dataset
    sim: dict[str, tuple[Float32, Bool | None]] = field(default_factory=dict)
    slice_parents: dict[str, str] = field(default_factory=dict)

    @property
    def family(self) -> Family | None:
        """Its family, where mpdt or the file knows it."""
        try:
            return self.dataset.contract()
        except MpdtError:
            return None

    @property
    def is_imported(self) -> bool:
        """No episode says who acted in it, or none which seed of ours made it."""
        episodes = self.dataset.episodes
        if "import" in self.dataset.spec:
            return True
        no_seed = (episodes.seed_key == UNKNOWN_SEED_KEY[0]).all()
        return bool(no_seed or (episodes.quality == -1).all())

    @property
    def is_smoke(self) -> bool:
        """A tiny version, whose few episodes decide nothing."""
        return "smoke" in self.dataset.version

    def own(self) -> Track:
        """The file's own episodes."""
        data = self.dataset
        horizon = data.spec.get("horizon")
        steps = data.steps
        return Track(
            "", data.episodes, steps.observations, steps.actions, steps.rewards,
            steps.terminations, steps.truncations, steps.successes,
            horizon if isinstance(horizon, int) else None,
        )  # fmt: skip

    def tracks(self) -> list[Track]:
        """The file's own episodes, then every TTA set."""
        found = [self.own()]
        for name, tta in self.dataset.tta.items():
            rewards, successes = self.sim[name]
            horizon = tta.rule.get("horizon")
            found.append(Track(
                f"tta {name}", tta, tta.observations, tta.actions, rewards,
                tta.terminations, tta.truncations, successes,
                horizon if isinstance(horizon, int) else None,
            ))  # fmt: skip
        return found


def read_material(path: Path, dataset: Dataset) -> Material:
    """The rest of an unchecked file. Raises: as `reader.open_dataset`."""
    sim = {name: open_tta_rewards(dataset, name, checked=False) for name in dataset.tta}
    with opened(path, source=dataset.source) as file:
        parents = {
            name: str(file.tree.text(f"slices/{name}", "parent"))
            for name in file.tree.below("slices")
            if "parent" in file.tree.attributes(f"slices/{name}")
        }
    return Material(path, dataset, sim, parents)
