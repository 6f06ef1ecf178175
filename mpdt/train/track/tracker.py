"""Tracker: what each of them has to do, and which there are.

    held()                how many points it has, asked of itself: the position of the run in it
    deliver(points)       the next ones, all of them or, after a kill, some of the first

Trackers differ in what survives a kill. So none is trusted with a position of ours: it is asked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Protocol

from mpdt.errors import UsageError, unknown_name
from mpdt.train.track.points import Facts, Point

TRACKERS = ("tensorboard", "wandb", "trackio")
PROJECT = "mpdt"
"""Where a tracker keeps runs of several projects, unless its own variable says another."""


class Tracker(Protocol):
    """One tracker of one run."""

    every_s: float
    """Least seconds between two deliveries; what ends a run is delivered at once."""

    def held(self) -> int:
        """Number of the first point that it does not have."""
        ...

    def deliver(self, points: Sequence[Point]) -> None:
        """Add them, in order; none at all begins the run, so that its settings are seen.

        Raises: whatever the package raises.
        """
        ...


def chosen_trackers(text: str) -> tuple[str, ...]:
    """`tensorboard,wandb` as names, each once.

    Raises: UsageError for an unknown one, or a package that is not installed, with its extra.
    """
    names = tuple(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
    if not names:
        raise UsageError("no tracker named", where="--log",
                         expected=f"some of {', '.join(TRACKERS)}")  # fmt: skip
    for name in names:
        if name not in TRACKERS:
            raise unknown_name("tracker", name, TRACKERS, where="--log")
        if find_spec(name) is None:
            raise UsageError(f"{name} is not installed", where="--log",
                             hint=f"python -m pip install 'mpdt[{name}]'")  # fmt: skip
    return names


def open_tracker(name: str, folder: Path, facts: Facts) -> Tracker:
    """The tracker of that name for the run in `folder`; imports its package, begins nothing."""
    from mpdt.train.track.tensorboard import TensorBoard
    from mpdt.train.track.trackio import Trackio
    from mpdt.train.track.wandb import WeightsAndBiases

    kinds: dict[str, Callable[[Path, Facts], Tracker]] = {
        "tensorboard": TensorBoard, "wandb": WeightsAndBiases, "trackio": Trackio,
    }  # fmt: skip
    return kinds[name](folder, facts)
