"""What the writer is given: a header, episodes in order, TTA sets in order."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mpdt.data.episode import Episode, PolicyInfo
from mpdt.data.store.digest import content_header
from mpdt.data.store.tables import TaskRow


@dataclass(frozen=True)
class FileHeader:
    """What a file says about itself.

    Args:
        spec: the datasets.yaml entry as plain values; its canonical JSON is hashed.
        tasks: rows in ascending family index.
        policies: every (task, hash) pair an episode may carry, in the order to be stored.
        parent: content hash of the source of a cut-out file.
        packages, platform: None = of this process.
        lineage: the steps from the collected file to this one, oldest first; JSON values.
        definition: of one's own family, see `spec.family.definition`; empty for shipped ones.
    """

    family: str
    name: str
    version: str
    license: str
    spec: Mapping[str, Any]
    observation_size: int
    action_size: int
    has_success: bool
    tasks: Sequence[TaskRow]
    policies: Sequence[PolicyInfo]
    parent: str = ""
    packages: Mapping[str, str] | None = None
    platform: Mapping[str, str] | None = None
    lineage: Sequence[Mapping[str, Any]] = ()
    definition: Mapping[str, Any] = field(default_factory=dict)

    def content(self) -> dict[str, Any]:
        """The part of the header that the content hash covers."""
        return content_header(
            self.family,
            [task.name for task in self.tasks],
            self.observation_size,
            self.action_size,
            self.has_success,
        )


@dataclass(frozen=True)
class EpisodeSource:
    """Episodes in canonical order, with their counts known beforehand.

    Args:
        source_ids: for cut-out files, the (E,) ids in the parent.
    """

    episodes: Iterable[Episode]
    num_episodes: int
    num_steps: int
    source_ids: Sequence[int] | None = None


@dataclass(frozen=True)
class TtaSource:
    """Episodes of a TTA set, ascending (task, block, row); rewards and successes are set apart.

    Args:
        preset_returns: family index of each task -> the return the user asks for.
        rule: low, high, action_scale, horizon; stored as JSON.
    """

    episodes: Iterable[Episode]
    num_episodes: int
    num_steps: int
    preset_returns: Mapping[int, float]
    rule: Mapping[str, Any] = field(default_factory=dict)
