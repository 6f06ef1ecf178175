"""Fingerprint: what datasets.lock keeps of a file, and how a file compares with it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import astuple
from typing import Any

import numpy as np

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.lock.file import Hashes, LockEntry, Size, run_text
from mpdt.data.spec.entry import canonical_json
from mpdt.data.store.dataset import Dataset
from mpdt.disk import sha256
from mpdt.seeding import HISTORY_STRIDE

_QUALITIES = {code: name for name, code in QUALITY_CODES.items()} | {-1: "unknown"}


def fingerprint(dataset: Dataset) -> LockEntry:
    """The lock's entry of a finished file; reads the whole file once, for `hashes.file`.

    Sets that were added to the file, and that no collection would make, are not part of it.
    """
    added = {f"tta-{name}" for name in dataset.tta} - {f"tta-{n}" for n in _planned_sets(dataset)}
    with dataset.source.open() as stream:
        file_hash = sha256(stream)
    return LockEntry(
        version=dataset.version,
        hashes=Hashes(
            spec=dataset.spec_hash,
            content=dataset.content_hash,
            file=file_hash,
            tta=_planned_sets(dataset),
        ),
        size=Size(
            bytes=dataset.path.stat().st_size,
            episodes=dataset.num_episodes,
            steps=dataset.num_steps,
        ),
        spec=dict(dataset.spec),
        runs={
            task: {run: run_text(digests) for run, digests in runs.items() if run not in added}
            for task, runs in digests_by_run(dataset).items()
        },
        policies=acting_policies(dataset),
        returns=_mean_returns(dataset),
        packages=dict(dataset.packages),
        platform=dict(dataset.platform),
        tables=table_hashes(dataset),
    )


def is_as_locked(dataset: Dataset, entry: LockEntry) -> bool:
    """Whether episodes and TTA sets are those of the entry; sets added later do not count."""
    found = (dataset.content_hash, _planned_sets(dataset))
    return found == (entry.hashes.content, entry.hashes.tta)


def _planned_sets(dataset: Dataset) -> dict[str, str]:
    """Content hashes of the TTA sets that the file's spec asks for."""
    planned = dataset.spec.get("tta") or {}
    return {name: tta.content_hash for name, tta in dataset.tta.items() if name in planned}


def digests_by_run(dataset: Dataset) -> dict[str, dict[str, bytes]]:
    """Task -> run -> its 32-byte digests one after another; TTA sets are runs `tta-<name>`."""
    episodes = dataset.episodes
    runs: dict[str, dict[str, bytes]] = {name: {} for name in dataset.tasks.names}
    rungs = np.where(episodes.quality == QUALITY_CODES["history"],
                     episodes.seed_key[:, 3] // HISTORY_STRIDE, 0)  # fmt: skip
    keys = np.stack([episodes.task, episodes.quality, rungs], axis=1).astype(np.int64)
    starts = np.flatnonzero(np.r_[len(keys) > 0, (np.diff(keys, axis=0) != 0).any(axis=1)])
    for start, stop in zip(starts, [*starts[1:], len(keys)], strict=True):
        task, quality, rung = (int(number) for number in keys[start])
        name = _QUALITIES.get(quality, str(quality))
        run = f"{name}-{rung:02d}" if name == "history" else name
        of = runs[dataset.tasks.names[task]]
        of[run] = of.get(run, b"") + episodes.digest[start:stop].tobytes()
    for name, tta in dataset.tta.items():
        for row, task_name in enumerate(dataset.tasks.names):
            digests = tta.digest[tta.task == row].tobytes()
            if digests:
                runs[task_name][f"tta-{name}"] = digests
    return runs


def lost_runs(dataset: Dataset, entry: LockEntry) -> list[str]:
    """Runs of `entry` that `dataset` does not begin with, as `task/run`.

    None are lost if every locked episode is still there, byte for byte and in its place.
    """
    found = digests_by_run(dataset)
    order = [f"{task}/{run}" for task, runs in found.items() for run in runs]
    lost = []
    for task, runs in entry.runs.items():
        for run, text in runs.items():
            count = int(text.partition(" ")[0])
            digests = found.get(task, {}).get(run, b"")
            if run_text(digests[: 32 * count]) != text:
                lost.append(f"{task}/{run}")
    return sorted(lost, key=lambda run: order.index(run) if run in order else len(order))


def table_hashes(dataset: Dataset) -> dict[str, str]:
    """Task -> first 16 hex digits of a hash over what no content hash covers and a reader uses:
    role, references and policies. A cut-out has those of its source for the tasks it keeps.

    Statistics and slices follow from the episodes, and `verify` computes them anew.
    """
    policies: dict[str, list[Any]] = {name: [] for name in dataset.tasks.names}
    table = dataset.policies
    columns = (table.rungs, table.levels, table.train_steps, table.mix_rates)
    for row, task in enumerate(table.tasks.tolist()):
        numbers = [repr(column[row].item()) for column in columns]
        policies[dataset.tasks.names[task]].append(
            [table.hashes[row].tobytes().hex(), table.names[row], *numbers]
        )
    found = {}
    for row, name in enumerate(dataset.tasks.names):
        references = dataset.tasks.references[row]
        said = [
            int(dataset.tasks.roles[row]),
            {kind: [repr(value) for value in astuple(reference)]
             for kind, reference in references.by_name.items()},
            [repr(number) for number in references.constant_action],
            sorted(policies[name]),
        ]  # fmt: skip
        found[name] = hashlib.sha256(canonical_json(said)).hexdigest()[:16]
    return found


def acting_policies(dataset: Dataset) -> dict[str, dict[str, str]]:
    """Task -> name -> first 16 hex digits of the hash, of each policy that has an episode."""
    table = dataset.policies
    found: dict[str, dict[str, str]] = {name: {} for name in dataset.tasks.names}
    for row in np.unique(dataset.episodes.policy).tolist():
        of = found[dataset.tasks.names[table.tasks[row]]]
        name = table.names[row]
        while name in of:  # two rungs rounded to one label
            name += "'"
        of[name] = table.hashes[row].tobytes().hex()[:16]
    return found


def _mean_returns(dataset: Dataset) -> dict[str, dict[str, float]]:
    """To three digits behind the point: for reading, never for comparing."""
    found: dict[str, dict[str, float]] = {name: {} for name in dataset.tasks.names}
    for row, name in enumerate(dataset.tasks.names):
        for quality in QUALITY_CODES:
            ids = dataset.select(task=row, quality=quality)
            if len(ids):
                found[name][quality] = round(float(dataset.episodes.returns[ids].mean()), 3)
    return found


def other_versions(old: Mapping[str, str], new: Mapping[str, str], names: tuple[str, ...]) -> str:
    """`mujoco 3.3.0 -> 3.4.0, ...` for those of `names` that differ, or nothing."""
    return ", ".join(
        f"{name} {old.get(name, 'absent')} -> {new.get(name, 'absent')}"
        for name in names
        if old.get(name) != new.get(name)
    )
