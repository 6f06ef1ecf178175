"""Small families of one's own for tests: a counter on a line, and what can be wrong with it.

observation  (position, steps so far)      reward  minus the distance to the goal
action       [-1, 1], added to the position
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

import mpdt
from mpdt.data.spec import own
from mpdt.data.spec.tasks import FAMILIES


class Line(gymnasium.Env[Any, Any]):
    """Starts within 0.1 of zero, by the seed of its reset; ends beyond 3 where `ends`."""

    def __init__(self, goal: float, ends: bool = False) -> None:
        self.goal, self.ends = goal, ends
        self.observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float64)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.at, self.steps = float(self.np_random.uniform(-0.1, 0.1)), 0
        return np.array([self.at, 0.0]), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.at += float(action[0])
        self.steps += 1
        away = abs(self.at - self.goal)
        over = self.ends and abs(self.at) > 3
        info = {"success": away < 0.5}
        return np.array([self.at, float(self.steps)]), -away, over, False, info


def make(task: mpdt.Task, ends: bool = False) -> Line:
    return Line(task.goal[0], ends)


def there(observations: Any, goals: Any) -> Any:
    """Straight to the goal."""
    return np.clip(goals - observations[:, :1], -1, 1)


TASKS = (
    mpdt.Task("left", 0, "train", (-2.0,)),
    mpdt.Task("right", 1, "train", (2.0,)),
    mpdt.Task("far", 2, "test", (4.0,)),
)
LINE: dict[str, Any] = {
    "name": "line", "tasks": TASKS, "columns": ("x [m]", "steps [1]"), "action_size": 1,
    "horizon": 8, "step_s": 1.0, "return_target": -5.0, "return_scale": 10.0, "env": make,
    "scripts": {"there": there}, "options": frozenset({"ends"}),
}  # fmt: skip


def line(**changes: Any) -> mpdt.Family:
    """The family, with some of its parts replaced."""
    return mpdt.Family(**(LINE | changes))


@contextmanager
def forgotten() -> Iterator[None]:
    """Whatever is registered or imported inside is forgotten afterwards."""
    families, folders = dict(FAMILIES), dict(own._FOLDERS)
    modules, path = set(sys.modules), list(sys.path)
    try:
        yield
    finally:
        FAMILIES.clear()
        FAMILIES.update(families)
        own._FOLDERS.clear()
        own._FOLDERS.update(folders)
        sys.path[:] = path
        for name in set(sys.modules) - modules:
            place = getattr(sys.modules[name], "__file__", None) or "site-packages"
            # Installed ones are imported once: torch registers itself and cannot do so again.
            if not (
                name.startswith("mpdt.") or "site-packages" in place
                or name.partition(".")[0] in sys.stdlib_module_names
            ):  # fmt: skip
                del sys.modules[name]
