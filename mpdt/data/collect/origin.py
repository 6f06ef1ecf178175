"""Origin: the data behind a policy, and what a file of the policy's episodes says of itself.

Such a file fits beside the data: family, root seed, horizon, block, options and goals are the
same, so `merge` takes both. What is its own stands in the spec under `policy`, and the lineage
names the data by its content hash.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import msgspec

from mpdt.data.episode import PolicyInfo
from mpdt.data.spec.entry import Behaviour, DatasetSpec, EpisodeCounts
from mpdt.data.spec.env import describe_env
from mpdt.data.spec.family import own_definition
from mpdt.data.spec.tasks import get_family
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.inherit import task_rows
from mpdt.data.store.sources import FileHeader
from mpdt.data.store.tables import TaskRow

BLOCK = 50
"""Episodes per unit of work, where the data does not say."""


@dataclass(frozen=True)
class Origin:
    """What of the data its policies' episodes depend on, or name.

    Args:
        spec: the data's own, as plain values.
        tasks: all of its tasks with their references, in ascending family index.
    """

    family: str
    name: str
    version: str
    license: str
    content_hash: str
    spec: Mapping[str, Any]
    tasks: tuple[TaskRow, ...]
    has_success: bool

    @classmethod
    def of(cls, dataset: Dataset) -> Origin:
        """Of an open file."""
        return cls(
            dataset.family, dataset.name, dataset.version, dataset.license, dataset.content_hash,
            dataset.spec, tuple(task_rows(dataset)), dataset.steps.successes is not None,
        )  # fmt: skip

    def collected_spec(self) -> DatasetSpec:
        """The entry that made the data, without any episodes.

        Imported data has none: there the seed is 0, and options are the simulator's own.
        """
        own = {k: v for k, v in self.spec.items() if k != "policy"}
        try:
            return msgspec.convert(own | {"episodes": {}, "tta": {}}, DatasetSpec)
        except msgspec.ValidationError:
            family = get_family(self.family)
            return DatasetSpec(
                name=self.name, version=self.version, family=self.family,
                horizon=int(self.spec.get("horizon", family.horizon)), seed=0, block=BLOCK,
                # Nobody of this ladder acts.
                behaviour=Behaviour(script="none"), episodes=EpisodeCounts(),
                license=self.license or "unknown", env=dict(self.spec.get("env", {})),
            )  # fmt: skip


@dataclass(frozen=True)
class Acted:
    """A policy as a file of its episodes names it.

    Args:
        name: for people.
        fingerprint: 32 bytes that change with whatever it does.
        facts: where it is from and how it acted, as JSON values; with the fingerprint they stand
            in the spec.
    """

    name: str
    fingerprint: bytes
    facts: Mapping[str, Any]

    @property
    def told(self) -> dict[str, Any]:
        """All of it as JSON values."""
        return {"name": self.name, "fingerprint": self.fingerprint.hex(), **self.facts}

    def info(self, task: int, level: float = math.nan) -> PolicyInfo:
        """A row of the policy table.

        Args:
            level: what it reached on this task in this file.
        """
        return PolicyInfo(self.fingerprint, task, -1, level, -1, 0.0, self.name)


def header_of_policy(
    origin: Origin,
    acted: Acted,
    verb: str,
    tasks: Sequence[TaskRow],
    levels: Mapping[int, float],
    **spec: Any,
) -> FileHeader:
    """The header of a file of a policy's episodes.

    Args:
        verb: what made them, for the lineage.
        tasks: those that have episodes.
        levels: by family index.
        spec: entries that take the place of the data's.
    """
    family = get_family(origin.family)
    told_of = own_definition(family)
    name = origin.name if "policy" in origin.spec else f"{origin.name}-policy"
    own = {k: v for k, v in origin.spec.items() if k not in ("import", "tta")}
    told = acted.told
    own |= {"name": name, "tasks": [task.name for task in tasks], "policy": told} | spec
    return FileHeader(
        family=origin.family,
        name=name,
        version=origin.version,
        license=origin.license,
        spec=own,
        observation_size=family.observation_size,
        action_size=family.action_size,
        has_success=family.has_success,
        tasks=[
            replace(one, env=describe_env(own, family.name, one.name, told_of)) for one in tasks
        ],
        policies=[acted.info(task.index, levels[task.index]) for task in tasks],
        lineage=[{"verb": verb, "rule": told, "from": [origin.content_hash]}],
        definition=told_of,
    )
