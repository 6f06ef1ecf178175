"""Sets for test-time adaptation: what goes into them, and what is set apart from them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import h5py
import numpy as np

from mpdt.data.episode import UNKNOWN_POLICY, Episode
from mpdt.data.store import layout
from mpdt.data.store.columns import GoalTable, StepTable, TaskIndex, write_table
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.digest import content_hash, episode_digest
from mpdt.data.store.sources import TtaSource
from mpdt.data.store.tables import Bool, Float32, Steps, TtaSet
from mpdt.disk import disk
from mpdt.errors import DataError, quoted, unknown_name
from mpdt.seeding import Quality


def unlabelled(episode: Episode) -> Episode:
    """The episode as its digest in a TTA set sees it: such sets store no policy or progress."""
    return replace(episode, quality=int(Quality.TTA), progress=0.0, policy=UNKNOWN_POLICY)


def fill_tta(
    group: h5py.Group,
    table: StepTable,
    source: TtaSource,
    content: Mapping[str, Any],
    tasks: TaskIndex,
    goals: GoalTable,
) -> None:
    """Write the episodes, table and attributes of one set into its preallocated group.

    Args:
        content: `FileHeader.content()` of the file; the set's own hash builds on it.
    Raises: DataError for a task without preset return.
    """
    where = f"{group.file.filename}: {group.name}"
    digests: list[bytes] = []
    presets: list[float] = []
    for episode in map(unlabelled, source.episodes):
        row = tasks.row(episode.task)
        if episode.task not in source.preset_returns:
            raise DataError(f"no preset return for task '{tasks.name(episode.task)}'", where=where)
        with disk(table.target):
            table.append(episode, row, goals.row(row, episode.goal))
        digests.append(episode_digest(episode, tasks.name(episode.task)))
        presets.append(source.preset_returns[episode.task])
    values = table.finish() | {
        "digest": np.frombuffer(b"".join(digests), np.uint8).reshape(-1, 32),
        "preset_return": presets,
    }
    identity = dict(content) | {
        "rule": dict(source.rule),
        "preset_return": {tasks.name(i): float(v) for i, v in source.preset_returns.items()},
    }
    with disk(table.target):
        write_table(group.create_group("episodes"), layout.TTA_EPISODES, values)
        layout.write_json(group, "rule", dict(source.rule))
        group.attrs["content_hash"] = content_hash(identity, digests)


def tta_episodes(
    dataset: Dataset, name: str, rewards: Float32, successes: Bool | None
) -> Iterator[Episode]:
    """The set's episodes put together again with what the simulator said.

    For checking digests and for cut-out files; adaptation has no business here. Get the last
    two arguments from `reader.open_tta_rewards`.
    """
    tta = dataset.tta[name]
    steps = Steps(
        tta.observations, tta.actions, rewards, tta.terminations, tta.truncations, successes
    )
    for i in range(len(tta)):
        yield steps.episode(
            int(tta.start[i]),
            int(tta.obs_start[i]),
            int(tta.length[i]),
            tta.seed_key[i],
            task=dataset.tasks.indices[tta.task[i]],
            goal=dataset.goals.of(int(tta.goal[i])),
            quality=int(Quality.TTA),
            progress=0.0,
            policy=UNKNOWN_POLICY,
        )


def find_tta_set(dataset: Dataset, name: str, rows: Sequence[int], asked: int = 0) -> TtaSet:
    """The set of that name, if it covers all these task rows.

    Args:
        asked: episodes that it has to have of each.
    Raises: DataError for a file without sets and a task without episodes in this one, or with fewer
        than are asked for; UsageError for an unknown name.
    """
    where = str(dataset.path)
    if not dataset.tta:
        raise DataError("no set for test-time adaptation in this file", where=where,
                        hint=_without_set(dataset))  # fmt: skip
    if name not in dataset.tta:
        raise unknown_name("TTA set", name, dataset.tta, where=where)
    chosen = dataset.tta[name]
    for row in rows:
        if not len(chosen.of_task(row)):
            raise DataError(f"the TTA set '{name}' has no episodes of test task "
                            f"{dataset.tasks.names[row]}", where=where,
                            hint="skip adaptation: --adapt.starts none")  # fmt: skip
        if len(chosen.of_task(row)) < asked:
            raise DataError(f"too few episodes of {dataset.tasks.names[row]} in the TTA set "
                            f"'{name}'", where=where, expected=f"{asked} (adapt.episodes)",
                            found=str(len(chosen.of_task(row))),
                            hint="ask for fewer, or 0 for all of them")  # fmt: skip
    return chosen


def _without_set(dataset: Dataset) -> str:
    skip = "skip adaptation: --adapt.starts none"
    return f"add one: mpdt-data tta {quoted(dataset.path)}; or {skip}"
