"""A simulator and a ladder that take no time, in place of the real ones of cheetah_dir.

    observation  20 numbers drawn from the key's env seed; they stay; column 0 counts steps
    reward       goal * mean of the action's six components, float64
    random       uniform actions: return about 0
    medium       goal * 0.5 in every component: return horizon / 2
    expert       goal: return horizon
    history      rung 0, 1, 2 of 3: goal * 0, 0.5, 1

Run as a script it is mpdt-data with this simulator. Spawned workers import the script of their
parent again, so they get it too. FAKE_DELAY_S lets every block take that long, FAKE_HANG_IN_PACK
stops for good when all episodes are in the file.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mpdt.data.collect import job, pack, runner
from mpdt.data.episode import PolicyInfo
from mpdt.data.sim.actors import Rows, UniformPolicy
from mpdt.data.sim.batch import StepResult
from mpdt.data.spec.tasks import Family, Task
from mpdt.seeding import SeedKey

DATASETS_YAML = """\
schema: 1
datasets:
  tiny:
    version: "1.0.0"
    family: cheetah_dir
    horizon: 5
    seed: 7
    block: 3
    behaviour: {network: fake, rungs: 3}
    episodes: {random: 4, medium: 4, expert: 4, history: 4}
    tta: {default: {episodes: 2, preset_return: auto}}
    reference: 2
    license: MIT
"""


class FakeBatch:
    observation_size, action_size = 20, 6

    def __init__(self, family: Family, tasks: Sequence[Task], env: Any = None) -> None:
        self.tasks, self.num_rows = tasks, len(tasks)
        self.low, self.high = np.full(6, -1.0), np.full(6, 1.0)

    def draw_goals(self, keys: Sequence[SeedKey]) -> list[Any]:
        return [np.array(task.goal) for task in self.tasks]

    def reset(self, keys: Sequence[SeedKey], goals: Sequence[Any]) -> Any:
        time.sleep(float(os.environ.get("FAKE_DELAY_S", "0")))
        draws = [np.random.default_rng(key.env_seed()).normal(size=20) for key in keys]
        self.state = np.stack(draws)
        self.goal = np.array([goal[0] for goal in goals])
        return self.state.copy()

    def step(self, actions: Any) -> StepResult:
        self.state = self.state + np.eye(20)[0]
        rewards = self.goal * actions.astype(np.float64).mean(axis=1)
        return StepResult(self.state.copy(), rewards, np.zeros(self.num_rows, bool), None)


class ConstantPolicy:
    """goal * level in every component."""

    def __init__(self, task: Task, rung: int, level: float) -> None:
        digest = bytes([task.index, rung, round(200 * level), 0]) * 8
        self.info = PolicyInfo(digest, task.index, rung, level, 100 * rung, 0.0, f"fake-{rung}")
        self.level = level

    def begin(self, rows: Rows) -> None:
        self.goals = np.array([goal[0] for goal in rows.goals])

    def act(self, step: int, observations: Any, rewards: Any = None) -> Any:
        return np.repeat(self.level * self.goals[:, None], 6, axis=1)


class FakeLadder:
    num_rungs = 3
    notice = ""
    weights = ""

    def __init__(self, medium: float = 0.5) -> None:
        self.medium = medium

    def policy(self, task: Task, quality: str, block: int) -> tuple[Any, float]:
        if quality == "random":
            return UniformPolicy(6, -1.0, 1.0, task=task.index), 0.0
        rung = {"medium": 1, "expert": 2}.get(quality, block // 65536)
        level = self.medium if rung == 1 else rung / 2
        return ConstantPolicy(task, rung, level), rung / 2

    def policies(self, tasks: Sequence[Task]) -> list[PolicyInfo]:
        names = ("random", "medium", "expert")
        infos = [self.policy(task, name, 0)[0].info for task in tasks for name in names]
        return infos + [self.policy(task, "history", 0)[0].info for task in tasks]


def install(patch: Any, medium: float = 0.5) -> None:
    """`patch(module, name, value)` puts the fakes in place."""
    ladder = FakeLadder(medium)
    patch(runner, "make_batch", FakeBatch)
    patch(job, "load_ladder", lambda spec: ladder)
    if "FAKE_HANG_IN_PACK" in os.environ:
        patch(pack, "standard_additions", lambda dataset: _hang(dataset.path))


def _hang(path: Path) -> None:
    path.with_name("packing").touch()
    time.sleep(600)


if __name__ in ("__main__", "__mp_main__"):
    install(setattr)

if __name__ == "__main__":
    import signal

    from mpdt.data.cli import main

    # A test run in the background of a script inherits an ignored Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)

    sys.exit(main())
