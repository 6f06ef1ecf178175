"""Locomotion tasks as a gymnasium VectorEnv over the batched engine.

Bit for bit what `gymnasium.vector.SyncVectorEnv` makes of single environments, autoreset at the
next step included.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import index
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from mpdt.data.sim.camera import SIDE, Camera, Pixels, check_render_mode, drawing, no_render_mode
from mpdt.data.sim.locomotion import LocomotionBatch
from mpdt.data.spec.family import view_of
from mpdt.data.spec.tasks import get_family
from mpdt.errors import UsageError
from mpdt.seeding import generator_of

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class LocomotionVector(VectorEnv[Floats, NDArray[np.float32], NDArray[Any]]):
    """`num_envs` episodes of one locomotion family side by side.

    Args:
        task: of every row, or one per row.
        horizon: steps after which a row is truncated; the family's own by default.
        threads: native threads; results do not depend on it.
        render_mode: rgb_array: `render()` gives one (480, 480, 3) uint8 frame per row.
        env: reward options, see `robots.reward_rule`.

    Shapes: observations (B, D) float64, actions (B, A) float32 in [-1, 1], rewards (B,) float64.
    Raises: UsageError for an unknown family, task or render mode, or another number of tasks than
        rows; ResetNeeded for what comes before the first reset; SimulatorError where nothing can
        draw.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # as the base declares it
        "render_modes": ["rgb_array"],
        "render_fps": 20,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int,
        family: str,
        task: str | Sequence[str],
        horizon: int | None = None,
        threads: int = 1,
        render_mode: str | None = None,
        **env: float | bool,
    ) -> None:
        row = get_family(family)
        names = [task] * num_envs if isinstance(task, str) else list(task)
        if len(names) != num_envs:
            raise UsageError("tasks and rows disagree", where=family,
                             expected=f"one task, or {num_envs}",
                             found=str(len(names)))  # fmt: skip
        check_render_mode(render_mode, family)
        self.render_mode, self._view = render_mode, view_of(row)
        tasks = [row.task(name) for name in names]
        self._batch = LocomotionBatch(row, tasks, env, threads)
        self._goals = [known.goal[0] for known in tasks]
        self._horizon = row.horizon if horizon is None else horizon
        self.num_envs = num_envs
        self.single_observation_space = spaces.Box(-np.inf, np.inf, (row.observation_size,), float)
        self.single_action_space = spaces.Box(
            row.action_low, row.action_high, (row.action_size,), np.float32
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._generators: list[np.random.Generator | None] = [None] * num_envs
        self._elapsed = np.zeros(num_envs, np.int64)
        self._over = np.zeros(num_envs, np.bool_)  # rows to reset at the next step
        self._begun = np.zeros(num_envs, np.bool_)
        self._camera: Camera | None = None

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Floats, dict[str, Any]]:
        """Start all rows, or some. A number seeds row i with seed + i; None: generators go on.

        Args:
            options: `reset_mask`, a bool array (B,), starts the rows where it is True; the others
                stay where they are.
        Raises: UsageError for another option, mask or number of seeds; ResetNeeded for a mask
            that leaves out rows which have never begun.
        """
        mask = self._mask((options or {}).get("reset_mask"), set(options or {}) - {"reset_mask"})
        seeds = self._seeds(seed)
        for row in np.flatnonzero(mask).tolist():
            own = seeds[row]
            if own is not None:
                self._generators[row] = generator_of(own)
            self._start(row)
        self._check_reset()
        return self._batch.observations(), {}

    def _mask(self, given: Any, others: set[str]) -> Bools:
        """Which rows to start."""
        if others:
            raise UsageError("no such reset option", where="reset", expected="reset_mask",
                             found=", ".join(sorted(others)))  # fmt: skip
        if given is None:
            return np.ones(self.num_envs, np.bool_)
        found = repr(given)
        if isinstance(given, np.ndarray):
            if given.shape == (self.num_envs,) and given.dtype == np.bool_ and given.any():
                return given
            found = f"{given.shape} {given.dtype}, {int(given.sum())} True"
        raise UsageError("not a mask of rows", where="reset_mask", found=found,
                         expected=f"a bool array ({self.num_envs},), True somewhere")  # fmt: skip

    def _seeds(self, seed: Any) -> Sequence[int | None]:
        """One seed per row."""
        if seed is None:
            return [None] * self.num_envs
        try:
            many: list[int | None] = [index(seed) + i for i in range(self.num_envs)]
        except TypeError:
            many = [None if own is None else index(own) for own in seed]
        if len(many) != self.num_envs:
            raise UsageError("seeds and rows disagree", where="reset",
                             expected=str(self.num_envs), found=str(len(many)))  # fmt: skip
        if any(own is not None and own < 0 for own in many):
            raise UsageError("a seed is at least 0", where="reset", found=str(seed))
        return many

    def _check_reset(self) -> None:
        if not self._begun.all():
            raise ResetNeeded("call reset() of all rows first")

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Floats, Floats, Bools, Bools, dict[str, Any]]:
        self._check_reset()
        again = np.flatnonzero(self._over)
        result = self._batch.step(np.asarray(actions, np.float32))
        self._elapsed += 1
        rewards, terminations = result.rewards.copy(), result.terminations.copy()
        truncations = self._elapsed >= self._horizon
        # Rows that ended at the step before start anew instead; their action is ignored.
        for row in again:
            self._start(int(row))
        rewards[again] = 0.0
        terminations[again] = truncations[again] = False
        self._over = terminations | truncations
        observations = self._batch.observations() if len(again) else result.observations
        return observations, rewards, terminations, truncations, {}

    def render(self) -> tuple[Pixels, ...]:
        """One frame per row. Raises: UsageError without a render mode; SimulatorError."""
        self._check_reset()
        if self.render_mode is None:
            raise no_render_mode("LocomotionVector")
        with drawing():
            if self._camera is None:
                self._camera = Camera(self._batch.scene(0)[0], self._view, SIDE, SIDE)
            rows = range(self.num_envs)
            return tuple(self._camera.frame(self._batch.scene(row)[1]) for row in rows)

    def close_extras(self, **kwargs: Any) -> None:
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _start(self, row: int) -> None:
        generator = self._generators[row]
        if generator is None:  # nobody seeded it: the system does, as for gymnasium's own
            generator = self._generators[row] = generator_of(None)
        self._batch.start_row(row, generator, self._goals[row])
        self._elapsed[row], self._over[row], self._begun[row] = 0, False, True
