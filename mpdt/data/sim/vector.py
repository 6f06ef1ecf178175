"""Locomotion tasks as a gymnasium VectorEnv over the batched engine.

Bit for bit what `gymnasium.vector.SyncVectorEnv` makes of single environments, autoreset at the
next step included.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from mpdt.data.sim.locomotion import LocomotionBatch
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
        env: reward options, see `robots.reward_rule`.

    Shapes: observations (B, D) float64, actions (B, A) float32 in [-1, 1], rewards (B,) float64.
    Raises: UsageError for an unknown family or task, or another number of tasks than rows.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # as the base declares it
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int,
        family: str,
        task: str | Sequence[str],
        horizon: int | None = None,
        threads: int = 1,
        **env: float | bool,
    ) -> None:
        row = get_family(family)
        names = [task] * num_envs if isinstance(task, str) else list(task)
        if len(names) != num_envs:
            raise UsageError("tasks and rows disagree", where=family,
                             expected=f"one task, or {num_envs}",
                             found=str(len(names)))  # fmt: skip
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

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Floats, dict[str, Any]]:
        """Start all rows. A number seeds row i with seed + i; without one generators go on.

        Raises: UsageError for options, of which there are none, or a wrong number of seeds.
        """
        if options:
            raise UsageError("no such reset option", where="reset", found=", ".join(options))
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed
        if seeds is not None and len(seeds) != self.num_envs:
            raise UsageError("seeds and rows disagree", where="reset",
                             expected=str(self.num_envs), found=str(len(seeds)))  # fmt: skip
        for row in range(self.num_envs):
            own = None if seeds is None else seeds[row]
            if own is not None:
                self._generators[row] = generator_of(own)
            self._start(row)
        return self._batch.observations(), {}

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Floats, Floats, Bools, Bools, dict[str, Any]]:
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

    def _start(self, row: int) -> None:
        generator = self._generators[row]
        if generator is None:  # nobody seeded it: the system does, as for gymnasium's own
            generator = self._generators[row] = generator_of(None)
        self._batch.start_row(row, generator, self._goals[row])
        self._elapsed[row], self._over[row] = 0, False
