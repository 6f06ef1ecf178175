"""Studies: lists of cells = data x method x seed, with the settings that are studied. Data only.

    first-pass    every method on cheetah_vel; the main ones on the other families
    ablations     one thing changed at a time, cheetah_vel

Settings are chosen on training tasks (docs/decisions/0011), never on test returns.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mpdt.errors import unknown_name


@dataclass(frozen=True)
class Cell:
    """One run of a study.

    Attributes:
        data: name of an entry, and of its file DATA.h5.
        label: what stands in the name and the table; the method unless settings differ.
        changes: settings over preset and method, nested as in `TrainConfig`.
    """

    data: str
    method: str
    seed: int = 0
    label: str = ""
    preset: str = "base"
    changes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return f"{self.data}.{self.label or self.method}.s{self.seed}"


STUDIES: Mapping[str, tuple[Cell, ...]] = {}


def get_study(name: str) -> tuple[Cell, ...]:
    """Raises: UsageError naming the nearest study."""
    if name not in STUDIES:
        raise unknown_name("study", name, STUDIES, where=f"study {name}")
    return STUDIES[name]
