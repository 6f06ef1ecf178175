"""Amount: how much of a file is simulated again, and which episodes that are.

They lie evenly spaced in every run of one task and quality, at least one of each; where the first
one lies comes from the content hash, so that a file is looked at in the same places.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mpdt.data.episode import Episode
from mpdt.data.store.ttaset import tta_episodes
from mpdt.data.verify.material import Material, Track
from mpdt.errors import DataError, UsageError
from mpdt.seeding import UNKNOWN_SEED_KEY

SHARE = "2%"
"""What is taken where nobody says how much."""


@dataclass(frozen=True)
class Amount:
    """How many episodes: a share of each run, or a number in all."""

    share: float | None = None
    number: int | None = None

    @classmethod
    def parse(cls, text: str) -> Amount:
        """`2%`, `40` or `all`. Raises: UsageError."""
        word = text.strip()
        try:
            if word == "all":
                return cls(share=1.0)
            if word.endswith("%") and 0 < float(word[:-1]) <= 100:
                return cls(share=float(word[:-1]) / 100)
            if int(word) > 0:
                return cls(number=int(word))
        except ValueError:
            pass
        raise UsageError("cannot read the amount", where="--replay", found=text,
                         expected="2%, 40 or all", hint="--skip replay for none")  # fmt: skip

    def of(self, run: int, total: int) -> int:
        """Episodes of a run of `run` among `total`; at least one."""
        share = self.share if self.share is not None else (self.number or 0) / max(1, total)
        return min(run, max(1, math.ceil(run * share - 1e-9)))


def chosen(material: Material, amount: Amount) -> list[tuple[str, list[int], list[Episode], int]]:
    """(track, ids, episodes, horizon) of the file's own episodes and of each TTA set.

    Of imported episodes those have seeds that an environment of theirs simulates, and nobody may
    have said a horizon, which is then 0; in a file that was collected somebody took them away.
    """
    data = material.dataset
    tracks = material.tracks()
    if "import" in data.spec:
        tracks = [track for track in tracks if _has_seeds(track)]
    total = sum(len(track) for track in tracks)
    found = []
    for track in tracks:
        kinds = getattr(track.table, "quality", np.zeros(len(track), np.int8))
        runs: dict[tuple[int, int], list[int]] = {}
        for i, key in enumerate(zip(track.table.task.tolist(), kinds.tolist(), strict=True)):
            runs.setdefault(key, []).append(i)
        ids = sorted(
            i for run in runs.values() for i in _spread(run, amount, total, data.content_hash)
        )
        if not ids:
            continue
        if track.horizon is None and "import" not in data.spec:
            raise DataError("its spec has no horizon", where=str(material.path))
        if track.label:
            name = track.label.removeprefix("tta ")
            every = list(tta_episodes(data, name, *material.sim[name]))
            episodes = [every[i] for i in ids]
        else:
            episodes = [data.episode(i) for i in ids]
        found.append((track.label, ids, episodes, track.horizon or 0))
    return found


def _has_seeds(track: Track) -> bool:
    return not (track.table.seed_key == np.array(UNKNOWN_SEED_KEY)).all()


def _spread(run: list[int], amount: Amount, total: int, content_hash: str) -> list[int]:
    count = amount.of(len(run), total)
    offset = int(content_hash[:8], 16) / 2**32
    return [run[int((k + offset) * len(run) / count)] for k in range(count)]
