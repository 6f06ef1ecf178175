"""Finding: the outcome of one check, and the words it is told in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from mpdt.data.store.dataset import Dataset
from mpdt.data.store.origin import damaged_hint
from mpdt.data.store.tables import Int64
from mpdt.errors import quoted


class Outcome(Enum):
    PASS = "PASS"
    WARN = "WARN"
    FAIL = "FAIL"
    SKIP = "SKIP"  # could not be looked at, because something it builds on failed
    NONE = "NONE"  # the file holds nothing of what is looked at


@dataclass(frozen=True)
class Finding:
    """What one check says of a file.

    Args:
        id: name of the check, as --only and --skip take it.
        text: one line; for a FAIL what is wrong, where, and which episodes are concerned.
        episodes: absolute ids of the first of them, at most three.
        hint: what to run next.
    """

    id: str
    outcome: Outcome
    text: str
    episodes: tuple[int, ...] = ()
    hint: str = ""

    def as_json(self) -> dict[str, Any]:
        return {
            "id": self.id,
            "outcome": self.outcome.value,
            "text": self.text,
            "episodes": list(self.episodes),
            "hint": self.hint,
        }

    def lines(self) -> list[str]:
        """`[PASS] hash        3,600 digests`, and a line with the next command."""
        found = [f"[{self.outcome.value}] {self.id:<11} {self.text}"]
        return [*found, f"{'':19}next: {self.hint}"] if self.hint else found


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong: what, and in which episodes of which track.

    `track` is empty for the file's own episodes, else names the TTA set. `total` counts all
    episodes concerned, `episodes` holds at least the first three.
    """

    what: str
    episodes: tuple[int, ...] = ()
    total: int = 0
    track: str = ""
    is_doubt: bool = False  # a WARN, not a FAIL

    def text(self) -> str:
        """`what: episodes 3, 4, 5 and 7 more (tta default)`."""
        if not self.episodes:
            return f"{self.what} ({self.track})" if self.track else self.what
        first = ", ".join(map(str, self.episodes[:3]))
        more = f" and {self.total - 3:,} more" if self.total > 3 else ""
        plural = "s" if self.total > 1 else ""
        place = f" of {self.track}" if self.track else ""
        return f"{self.what}: episode{plural} {first}{more}{place}"


def drop_hint(data: Dataset, faults: Sequence[Fault]) -> str:
    """How to go on without the episodes of these faults; how to mend what is no episode."""
    if not faults:
        return ""
    ids = sorted({i for one in faults if not one.track for i in one.episodes[:3]})
    if not ids:
        return damaged_hint(data.path, data)
    return f"mpdt-data drop {quoted(data.path)} --episodes {','.join(map(str, ids))} -o OUT.h5"


def fault(
    what: str, episodes: Sequence[int] | Int64, track: str = "", doubt: bool = False
) -> Fault:
    """A Fault of these episodes, all of them given."""
    return Fault(what, tuple(int(i) for i in episodes[:3]), len(episodes), track, doubt)


def nothing(id: str, why: str) -> Finding:
    """Neither passed nor failed: `why` says what the file does not hold."""
    return Finding(id, Outcome.NONE, f"nothing to check: {why}")


def judge(id: str, faults: Sequence[Fault], passed: str, hint: str = "") -> Finding:
    """PASS with `passed` where there is no fault; else all faults in one finding."""
    if not faults:
        return Finding(id, Outcome.PASS, passed)
    worst = [one for one in faults if not one.is_doubt] or list(faults)
    outcome = Outcome.WARN if worst[0].is_doubt else Outcome.FAIL
    shown = "; ".join(one.text() for one in faults[:3])
    more = f"; and {len(faults) - 3} more" if len(faults) > 3 else ""
    own = next((one.episodes for one in worst if one.episodes and not one.track), ())
    return Finding(id, outcome, shown + more, own[:3], hint)
