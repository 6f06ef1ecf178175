"""Seeds: what the simulator was reset with, of each episode of a file.

collected   the root seed of its spec and the episode's key
imported    where its environment simulates it: `import.seeds[block][row]` of its spec
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpdt.data.episode import Episode
from mpdt.data.store.dataset import Dataset
from mpdt.errors import DataError
from mpdt.seeding import UNKNOWN_SEED_KEY, Quality, SeedKey, Stream

_NUMBER = re.compile(r"[0-9]{1,20}")


@dataclass(frozen=True)
class _Given(SeedKey):
    """The key of an episode whose seed somebody else chose."""

    given: int = 0

    def env_seed(self, stream: Stream = Stream.RESET) -> int:
        return self.given


@dataclass(frozen=True)
class Seeds:
    """Of one file; picklable.

    Args:
        root: of what was collected; None where the file has none.
        recorded: of what was imported, by source and episode; as text, since 64 bits are more than
            JSON has room for here.
    """

    root: int | None
    recorded: Sequence[Sequence[str]]
    where: str

    @classmethod
    def of(cls, dataset: Dataset, root: Any) -> Seeds:
        told = dataset.spec.get("import")
        recorded = told.get("seeds", ()) if isinstance(told, dict) else ()
        root = root if isinstance(root, int) else None
        return cls(root, recorded if isinstance(recorded, list) else (), str(dataset.path))

    def check(self, episode: Episode) -> None:
        """Raises: DataError for an episode without a seed."""
        self.key(episode)

    def key(self, episode: Episode) -> SeedKey:
        """Raises: DataError."""
        found = episode.seed_key
        if found == UNKNOWN_SEED_KEY:
            raise DataError("episodes without a seed cannot be simulated", where=self.where)
        if found[2] == Quality.RECORDED:
            try:
                seed = self.recorded[found[3]][found[4]]
            except (IndexError, TypeError, KeyError):
                seed = ""
            if not isinstance(seed, str) or not _NUMBER.fullmatch(seed):
                raise DataError("its spec does not say what an episode began with",
                                where=f"{self.where}, {found}")  # fmt: skip
            return _Given(0, *found, given=int(seed))
        if self.root is None:
            raise DataError("its spec has no seed", where=self.where)
        return SeedKey(self.root, *found)
