"""TaskRows: B episodes of one Meta-World task in lockstep, for the price of one env.

    reset   row by row, as the env does it; its state and what it remembers go to the row
    step    actions -> controls of all rows; physics row after row (physics.py); then
            observations, rewards and successes of all rows at once (scene.py and the rules)

Bit for bit what an env per row returns; the tests compare all 50 tasks with the published step.

Used by metaworld.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from mpdt.data.sim.lockstep.physics import Physics
from mpdt.data.sim.lockstep.scene import Rules, Scene
from mpdt.data.sim.lockstep.tasks import RULES
from mpdt.data.sim.lockstep.terms import BoolArray, FloatArray, length, values

_HAND_DOWN = (1.0, 0.0, 1.0, 0.0)
_KEPT = ("_target_pos", "obj_init_pos", "init_tcp")
_READS = ("xpos", "site_xpos")


class TaskRows:
    """Rows of `task_name`.

    Args:
        env: the task's env (`sawyer.QuickSawyer`), whose simulator the rows share.
        reset: one reset of it, from a reset vector to the first observation (39,).
    """

    def __init__(
        self, task_name: str, env: Any, reset: Callable[[FloatArray], FloatArray], rows: int
    ) -> None:
        self._env, self._reset, self._rules = env, reset, RULES[task_name]
        rules, ask = self._rules, None
        if rules.touches:
            geom = env._get_id_main_object()

            def ask() -> bool:
                return bool(env.touching_object(geom))

        reads = (*_READS, *rules.reads)
        self._physics = Physics(env.model, env.data, env.frame_skip, rows, reads, ask)
        self._scene = Scene(self._physics, {})
        self._before = np.zeros((rows, 18))

    def reset(self, goals: Sequence[FloatArray]) -> FloatArray:
        """First observations (B, 39)."""
        names = (*_KEPT, *self._rules.keeps)
        first, kept = [], []
        for row, goal in enumerate(goals):
            first.append(self._reset(goal))
            self._physics.keep(row)
            # Copies: some of what an env remembers are views into the simulator.
            kept.append([np.array(getattr(self._env, name), np.float64) for name in names])
        columns = zip(*kept, strict=True)
        self._scene = Scene(
            self._physics, {name: np.stack(of) for name, of in zip(names, columns, strict=True)}
        )
        observations = np.stack(first)
        self._before = observations[:, :18].copy()
        return observations

    def step(self, actions: npt.NDArray[np.float32]) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Observations (B, 39), rewards (B,) and successes (B,) after actions (B, 4)."""
        env, physics, scene = self._env, self._physics, self._scene
        # A product in float32, as published: Meta-World scales the action as it is given.
        way = actions[:, :3].clip(-1, 1) * env.action_scale
        places = physics.mocap_places
        places[:] = (places + way).clip(env.mocap_low, env.mocap_high)
        physics.mocap_turns[:] = _HAND_DOWN
        physics.controls[:, 0], physics.controls[:, 1] = actions[:, 3], -actions[:, 3]
        physics.step()
        now = observe(self._rules, scene)
        space = env.sawyer_observation_space
        seen = np.concatenate((now, self._before, self._rules.goal(scene)), axis=1)
        self._before = now
        scene.show(seen.clip(space.low, space.high), actions[:, 3], physics.answers)
        rewards, successes = self._rules.score(scene)
        return scene.seen, values(rewards), successes

    def show(self, row: int) -> None:
        """Put the row's scene into the env's simulator, for a camera."""
        self._physics.show(row)


def observe(rules: Rules, scene: Scene) -> FloatArray:
    """The half of an observation that tells of now, (B, 18), not clipped."""
    now = np.zeros((scene.rows, 18))
    now[:, :3] = scene.body("hand")
    apart = length(scene.body("rightclaw") - scene.body("leftclaw"))
    now[:, 3] = (apart / 0.1).clip(0.0, 1.0)
    for number, (place, turn) in enumerate(rules.things):
        at = 4 + 7 * number
        now[:, at : at + 3] = place(scene)
        now[:, at + 3 : at + 7] = turn(scene)
    return now
