"""The parts of a file as plain arrays in memory; no HDF5 object among them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mpdt.data.episode import Episode
from mpdt.data.reference import References

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int8 = NDArray[np.int8]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]
Bytes = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Steps:
    """Flat step arrays, episodes one after another; maps of the file, or arrays in RAM.

    observations (N+E, D) f4 hold T+1 rows per episode; actions (N, A) f4; rewards (N,) f4;
    terminations, truncations, successes (N,) bool. `successes` is None without success.
    """

    observations: Float32
    actions: Float32
    rewards: Float32
    terminations: Bool
    truncations: Bool
    successes: Bool | None

    def episode(
        self, start: int, obs_start: int, length: int, seed_key: NDArray[Any], *,
        task: int, goal: NDArray[np.float64], quality: int, progress: float, policy: bytes,
    ) -> Episode:  # fmt: skip
        """The episode whose rows begin there, of these labels; its arrays are views."""
        rows = slice(start, start + length)
        return Episode(
            observations=self.observations[obs_start : obs_start + length + 1],
            actions=self.actions[rows],
            rewards=self.rewards[rows],
            terminations=self.terminations[rows],
            truncations=self.truncations[rows],
            successes=None if self.successes is None else self.successes[rows],
            task=task, goal=goal, quality=quality, progress=progress, policy=policy,
            seed_key=tuple(map(int, seed_key)),  # type: ignore[arg-type]
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Episodes:
    """Columns of length E in canonical order: ascending (task, quality, block, row).

    task, policy, goal are rows of the file's own tables. `returns` is the column `return`
    (float64 sum of rewards). `source`, only in cut-out files, is the id in the parent.
    """

    task: Int32
    policy: Int32
    goal: Int32
    start: Int64
    obs_start: Int64
    length: Int32
    quality: Int8
    progress: Float32
    seed_key: NDArray[np.uint32]
    returns: Float64
    success: Bool
    digest: Bytes
    source: Int64 | None

    def __len__(self) -> int:
        return len(self.task)


@dataclass(frozen=True, eq=False)
class Tasks:
    """K rows. `envs` = how to build the env (entry point, kwargs); role 0 train, 1 test, 2 both.

    `indices` are positions in the family's own list (what `Episode.task` and seed keys hold),
    or the row itself where mpdt does not know the family.

    `references` holds what the reference policies return, one entry per row; `ref_<policy>` are
    their means (K,) f8, NaN where never measured.
    """

    names: tuple[str, ...]
    indices: tuple[int, ...]
    envs: tuple[dict[str, Any], ...]
    roles: Int8
    references: tuple[References, ...]

    def __len__(self) -> int:
        return len(self.names)

    def means(self, policy: str) -> Float64:
        """Mean returns (K,) of one policy."""
        return np.array([references[policy].mean for references in self.references])

    @property
    def ref_zero(self) -> Float64:
        return self.means("zero")

    @property
    def ref_random(self) -> Float64:
        return self.means("random")

    @property
    def ref_constant(self) -> Float64:
        return self.means("constant")

    @property
    def ref_expert(self) -> Float64:
        return self.means("expert")

    @property
    def train_rows(self) -> list[int]:
        """Rows of role train or both: all that statistics and training may see."""
        return [row for row, role in enumerate(self.roles) if role in (0, 2)]

    @property
    def test_rows(self) -> list[int]:
        """Rows of role test or both."""
        return [row for row, role in enumerate(self.roles) if role in (1, 2)]


@dataclass(frozen=True, eq=False)
class Goals:
    """M rows: values (M, G) f8 zero-padded, dims (M,) valid numbers, tasks (M,) task row."""

    values: Float64
    dims: Int32
    tasks: Int32

    def of(self, row: int) -> Float64:
        """The goal without its padding, shape (dim,)."""
        return np.array(self.values[row, : self.dims[row]])


@dataclass(frozen=True, eq=False)
class Policies:
    """P rows; see `mpdt.data.episode.PolicyInfo`. `tasks` are rows of the task table."""

    hashes: Bytes
    tasks: Int32
    rungs: Int32
    levels: Float32
    train_steps: Int64
    mix_rates: Float32
    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Slice:
    """A named, ascending list of absolute episode ids, the rule that made it, and the
    content hash of the file it was made for (filled in by the writer)."""

    ids: Int64
    rule: Mapping[str, Any]
    parent: str = ""


@dataclass(frozen=True, eq=False)
class Stats:
    """Statistics of data columns over training tasks.

    fields[field][stat] is float64 of shape (D,), (A,) or (1,); names in
    `layout.STATS_FIELDS` and `layout.STATS`. `std` is raw: a normaliser uses max(std, 1e-6).

    Args:
        slice: name of the slice they were computed on, "" = the whole file.
        tasks_seen: rows of the task table.
        constant: per field the columns without spread.
    """

    fields: Mapping[str, Mapping[str, Float64]]
    slice: str
    tasks_seen: tuple[int, ...]
    constant: Mapping[str, tuple[int, ...]]


@dataclass(frozen=True, eq=False)
class TtaSet:
    """Unlabelled random-action episodes of some tasks: all that zero-shot may see.

    Columns as in `Steps` and `Episodes`, one row per episode of the set; `preset_return` (E,)
    f4 is the return the user asks for. There is no reward in here on purpose: protocols that
    say so read it through `reader.open_tta_rewards`.
    """

    name: str
    rule: Mapping[str, Any]
    content_hash: str
    observations: Float32
    actions: Float32
    terminations: Bool
    truncations: Bool
    task: Int32
    goal: Int32
    start: Int64
    obs_start: Int64
    length: Int32
    seed_key: NDArray[np.uint32]
    digest: Bytes
    preset_return: Float32

    def __len__(self) -> int:
        return len(self.task)

    def of_task(self, row: int, episodes: int | None = None) -> Int64:
        """Episode ids inside the set of one task row; the first n are the set of size n."""
        return np.flatnonzero(self.task == row)[:episodes].astype(np.int64)


@dataclass(frozen=True)
class TaskRow:
    """One row of the task table for the writer. References may follow later (`Additions`).

    Args:
        index: position in the family's list, what `Episode.task` holds.
        env: JSON-able description of how to build the env.
    """

    name: str
    index: int
    role: Literal["train", "test", "both"]
    env: Mapping[str, Any]
    references: References = field(default_factory=References)


@dataclass(frozen=True)
class Additions:
    """What can only be known once all episodes are in: the result of `write_file(finish=)`.

    Args:
        slices: by name; `parent` is filled in.
        stats: result of `mpdt.data.slices.stats.compute_stats`.
        references: by task name; tasks that are not named keep the header's.
    """

    slices: Mapping[str, Slice] = field(default_factory=dict)
    stats: Stats | None = None
    references: Mapping[str, References] = field(default_factory=dict)
