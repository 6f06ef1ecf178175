"""What a cut-out file takes over from the file it is cut out of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mpdt.data.spec.env import describe_env
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.layout import ROLE_CODES
from mpdt.data.store.proof import proven, proven_tta
from mpdt.data.store.sources import EpisodeSource, FileHeader, TtaSource
from mpdt.data.store.tables import Int64, TaskRow

_ROLES = {code: role for role, code in ROLE_CODES.items()}


def header_of(
    dataset: Dataset,
    rows: Sequence[int] | None = None,
    step: Mapping[str, Any] | None = None,
) -> FileHeader:
    """The header of a file cut out of `dataset`, with its hash as parent.

    Packages and platform stay those that made the episodes.

    Args:
        rows: rows of the task table to keep, ascending; None = all.
        step: what is done to it now, for the lineage: `verb` and its rule.
    """
    kept = list(range(len(dataset.tasks))) if rows is None else list(rows)
    tasks = [task_rows(dataset)[row] for row in kept]
    indices = {task.index for task in tasks}
    return FileHeader(
        family=dataset.family,
        name=dataset.name,
        version=dataset.version,
        license=dataset.license,
        spec=dataset.spec,
        observation_size=dataset.observation_size,
        action_size=dataset.action_size,
        has_success=dataset.steps.successes is not None,
        tasks=tasks,
        policies=[policy for policy in dataset.policy_infos() if policy.task in indices],
        parent=dataset.content_hash,
        packages=dataset.packages,
        platform=dataset.platform,
        definition=dataset.definition,
        lineage=(*dataset.lineage, *([] if step is None else [lineage_step(step, dataset)])),
    )


def lineage_step(step: Mapping[str, Any], *sources: Dataset) -> dict[str, Any]:
    """One entry of the lineage: the step with the content hashes it started from."""
    return dict(step) | {"from": [source.content_hash for source in sources]}


def task_rows(dataset: Dataset) -> list[TaskRow]:
    """The task table as the writer takes it. How to build the simulator is said anew."""
    tasks = dataset.tasks
    return [
        TaskRow(
            name=tasks.names[row],
            index=tasks.indices[row],
            role=_ROLES[int(tasks.roles[row])],
            env=describe_env(dataset.spec, dataset.family, tasks.names[row], dataset.definition),
            references=tasks.references[row],
        )
        for row in range(len(tasks))
    ]


def episodes_of(dataset: Dataset, ids: Int64) -> EpisodeSource:
    """The episodes of ascending ids, with those ids as `source` column.

    Each is compared with its digest when it is asked for.
    """
    return EpisodeSource(
        episodes=(proven(dataset, i) for i in ids.tolist()),
        num_episodes=len(ids),
        num_steps=int(dataset.episodes.length[ids].sum()),
        source_ids=ids.tolist(),
    )


def tta_of(dataset: Dataset, name: str, rows: Sequence[int] | None = None) -> TtaSource:
    """A TTA set of `dataset` for another file, simulator's rewards included.

    Args:
        rows: rows of the task table to keep; None = all.
    """
    tta = dataset.tta[name]
    kept = set(range(len(dataset.tasks)) if rows is None else rows)
    ids = [i for i in range(len(tta)) if int(tta.task[i]) in kept]
    indices = {dataset.tasks.indices[row] for row in kept}
    presets = {dataset.tasks.indices[tta.task[i]]: float(tta.preset_return[i]) for i in ids}
    return TtaSource(
        episodes=(e for e in proven_tta(dataset, name) if e.task in indices),
        num_episodes=len(ids),
        num_steps=int(sum(tta.length[i] for i in ids)),
        preset_returns=presets,
        rule=tta.rule,
    )
