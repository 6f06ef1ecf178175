"""StepCheck: a check that looks at every step, in one pass over the file with all the others."""

from __future__ import annotations

from typing import Protocol

from mpdt.data.verify.finding import Fault, Finding
from mpdt.data.verify.material import Chunk, Track

SHOWN = 3


class StepCheck(Protocol):
    """Sees every chunk of every track once, in order, then says what it found."""

    id: str

    def look(self, track: Track, chunk: Chunk) -> None: ...

    def finding(self) -> Finding: ...


class Faults:
    """Faults that gather over chunks: the first episodes by kind and track, and how many."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str], list[int]] = {}
        self._totals: dict[tuple[str, str], int] = {}

    def add(self, what: str, track: Track, episodes: list[int]) -> None:
        """Episodes of one chunk, none twice."""
        if episodes:
            key = (what, track.label)
            kept = self._found.setdefault(key, [])
            kept += episodes[: SHOWN - len(kept)]
            self._totals[key] = self._totals.get(key, 0) + len(episodes)

    def all(self) -> list[Fault]:
        return [
            Fault(what, tuple(episodes), self._totals[what, label], label)
            for (what, label), episodes in self._found.items()
        ]
