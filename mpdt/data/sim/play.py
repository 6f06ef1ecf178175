"""Block -> episodes: one policy acts in one batch until every row has ended.

    row 0  o0 a0 r0  o1 a1 r1  o2 a2 r2  o3          horizon 3: truncated at its last step
    row 1  o0 a0 r0  o1 a1 r1  o2                    fell at step 1: terminated, T = 2
    row 2  (padding: fills the policy's batch, never simulated, never kept)

What is stored is what acted: the action is cast to float32 and clipped first, and exactly
those numbers go to the simulator, so that a replay of the file repeats the episode.

Used by collect/runner.py, portions.py and probe.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from mpdt.data.episode import Episode
from mpdt.data.sim.actors import OpenLoopPolicy, Policy, Rows
from mpdt.data.sim.batch import BatchEnv, Play, PlaysAhead, StepResult, roll_out
from mpdt.errors import DataError
from mpdt.seeding import SeedKey

FloatArray = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]


@dataclass
class _Record:
    """Columns of all rows while the block runs; row b is valid up to `lengths[b]`."""

    observations: Float32Array  # (B, H + 1, D)
    actions: Float32Array  # (B, H, A)
    rewards: Float32Array  # (B, H)
    terminations: BoolArray  # (B, H)
    successes: BoolArray | None  # (B, H)
    lengths: npt.NDArray[np.int64]  # (B,)


def run_block(
    env: BatchEnv,
    policy: Policy,
    keys: Sequence[SeedKey],
    *,
    horizon: int,
    quality: int,
    progress: float,
    hidden_columns: Sequence[int] = (),
    width: int | None = None,
    clip: bool = True,
    goal_keys: Sequence[SeedKey] | None = None,
) -> list[Episode]:
    """Run one episode per key and return them in the order of the keys.

    Args:
        env: as many rows as there are keys.
        policy: sees the goal; its hash goes into every episode.
        keys: seed key of each row; its task is the episode's task.
        horizon: steps, at least 1; an episode that reaches it is truncated.
        quality, progress: stored with every episode.
        hidden_columns: observation columns stored as 0 (the policy still sees them).
        width: rows the policy is evaluated at, padded with copies of the first one. A policy
            network gives other last bits at other batch widths, and contacts amplify that,
            so a short last block must use the width of the full ones. Rows of an env do not
            see each other, so padding never needs simulating.
        clip: False for TTA sets, whose file keeps the drawn numbers and whose simulator
            clips inside its own step.
        goal_keys: what each row's goal is drawn from, where goals are shared by episodes;
            default: its own key.

    A policy whose actions depend on nothing it sees is run natively where the env can.

    Returns: len(keys) episodes of 1 to `horizon` steps.

    Raises: DataError if the simulator returned a number that is not finite.
    """
    assert len(keys) == env.num_rows, "one key per row"
    assert horizon >= 1
    padding = max(0, (width or 0) - len(keys))
    goals = env.draw_goals(goal_keys or keys)
    observations = env.reset(keys, goals)
    extra = [keys[-1].at_row(keys[-1].row + 1 + row) for row in range(padding)]
    policy.begin(Rows([*keys, *extra], [*goals, *goals[-1:] * padding], horizon))
    record = _empty_record(env, horizon)
    low, high = env.low.astype(np.float32), env.high.astype(np.float32)

    def stored(actions: npt.NDArray[np.floating[Any]]) -> Float32Array:
        cast = actions[: len(keys)].astype(np.float32)
        return np.clip(cast, low, high) if clip else cast

    if isinstance(policy, OpenLoopPolicy) and isinstance(env, PlaysAhead):
        actions = stored(policy.all_actions())
        _store_play(record, actions, env.play(actions), hidden_columns)
    else:
        _store_observations(record, 0, observations, hidden_columns)

        def choose(
            step: int, seen: FloatArray, rewards: FloatArray | None, running: BoolArray
        ) -> Float32Array:
            shown = np.concatenate([seen, np.repeat(seen[:1], padding, axis=0)])
            return stored(policy.act(step, shown))

        for rolled in roll_out(env, observations, choose, horizon):
            _store_step(record, rolled.step, rolled.actions, rolled.result, hidden_columns)
            record.lengths[rolled.running] = rolled.step + 1
    return [
        _episode(record, row, key, goals[row], policy, horizon, quality, progress)
        for row, key in enumerate(keys)
    ]


def _empty_record(env: BatchEnv, horizon: int) -> _Record:
    rows = env.num_rows
    return _Record(
        observations=np.zeros((rows, horizon + 1, env.observation_size), dtype=np.float32),
        actions=np.zeros((rows, horizon, env.action_size), dtype=np.float32),
        rewards=np.zeros((rows, horizon), dtype=np.float32),
        terminations=np.zeros((rows, horizon), dtype=np.bool_),
        successes=None,
        lengths=np.zeros(rows, dtype=np.int64),
    )


def _store_play(
    record: _Record, actions: Float32Array, play: Play, hidden_columns: Sequence[int]
) -> None:
    record.observations[:] = play.observations
    record.observations[:, :, list(hidden_columns)] = 0.0
    record.actions[:] = actions
    record.rewards[:] = play.rewards
    record.terminations[:] = play.terminations
    ended = play.terminations.any(axis=1)
    record.lengths[:] = np.where(ended, play.terminations.argmax(axis=1) + 1, actions.shape[1])


def _store_observations(
    record: _Record,
    index: int,
    observations: npt.NDArray[np.float64],
    hidden_columns: Sequence[int],
) -> None:
    record.observations[:, index] = observations
    record.observations[:, index, list(hidden_columns)] = 0.0


def _store_step(
    record: _Record,
    step: int,
    actions: Float32Array,
    result: StepResult,
    hidden_columns: Sequence[int],
) -> None:
    record.actions[:, step] = actions
    record.rewards[:, step] = result.rewards
    record.terminations[:, step] = result.terminations
    if result.successes is not None:
        if record.successes is None:
            record.successes = np.zeros(record.rewards.shape, dtype=np.bool_)
        record.successes[:, step] = result.successes
    _store_observations(record, step + 1, result.observations, hidden_columns)


def _episode(
    record: _Record,
    row: int,
    key: SeedKey,
    goal: npt.NDArray[np.float64],
    policy: Policy,
    horizon: int,
    quality: int,
    progress: float,
) -> Episode:
    length = int(record.lengths[row])
    # A view would keep the whole block in memory as long as one of its episodes: copy.
    observations = record.observations[row, : length + 1].copy()
    actions = record.actions[row, :length].copy()
    rewards = record.rewards[row, :length].copy()
    _check_finite(key, observations, actions, rewards)
    truncations = np.zeros(length, dtype=np.bool_)
    truncations[-1] = length == horizon
    successes = record.successes
    return Episode(
        observations=observations,
        actions=actions,
        rewards=rewards,
        terminations=record.terminations[row, :length].copy(),
        truncations=truncations,
        successes=None if successes is None else successes[row, :length].copy(),
        task=key.task,
        goal=np.asarray(goal, dtype=np.float64),
        quality=quality,
        progress=progress,
        policy=policy.info.hash,
        seed_key=key.spawn_key,
    )


def _check_finite(key: SeedKey, *arrays: Float32Array) -> None:
    for name, array in zip(("observations", "actions", "rewards"), arrays, strict=True):
        if not np.isfinite(array).all():
            step = int(np.flatnonzero(~np.isfinite(array).reshape(len(array), -1).all(axis=1))[0])
            raise DataError(
                f"the simulator left the finite numbers: {name} at step {step}",
                where=f"task {key.task}, quality {key.quality}, block {key.block}, row {key.row}",
                hint="a policy with such large actions cannot be recorded; report task and seed",
            )
