"""Block -> episodes: one policy acts in one batch until every row has ended.

    row 0  o0 a0 r0  o1 a1 r1  o2 a2 r2  o3          horizon 3: truncated at its last step
    row 1  o0 a0 r0  o1 a1 r1  o2                    fell at step 1: terminated, T = 2
    row 2  (padding: fills the policy's batch, never simulated, never kept)

What is stored is what acted: the action is cast to float32 and clipped first, and exactly
those numbers go to the simulator, so that a replay of the file repeats the episode.

Used by collect/runner.py, portions.py and probe.py; `Record` also where a trained policy is judged
and its episodes are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from mpdt.data.episode import Episode
from mpdt.data.sim.actors import JoiningPolicy, OpenLoopPolicy, Policy, Rows
from mpdt.data.sim.batch import BatchEnv, Play, PlaysAhead, Rolled, roll_out
from mpdt.errors import DataError
from mpdt.seeding import SeedKey

FloatArray = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]


@dataclass
class Record:
    """Columns of all rows while episodes run; row b is valid up to `lengths[b]`.

    Args:
        hidden_columns: observation columns that are stored as 0.
    """

    observations: Float32Array  # (B, H + 1, D)
    actions: Float32Array  # (B, H, A)
    rewards: Float32Array  # (B, H)
    terminations: BoolArray  # (B, H)
    successes: BoolArray | None  # (B, H)
    lengths: npt.NDArray[np.int64]  # (B,)
    hidden_columns: tuple[int, ...]

    @classmethod
    def of(cls, first: FloatArray, action_size: int, horizon: int, hidden: Sequence[int]) -> Record:
        """Of episodes that begin with `first` (B, D), what the reset gave."""
        rows = len(first)
        record = cls(
            observations=np.zeros((rows, horizon + 1, first.shape[1]), dtype=np.float32),
            actions=np.zeros((rows, horizon, action_size), dtype=np.float32),
            rewards=np.zeros((rows, horizon), dtype=np.float32),
            terminations=np.zeros((rows, horizon), dtype=np.bool_),
            successes=None,
            lengths=np.zeros(rows, dtype=np.int64),
            hidden_columns=tuple(hidden),
        )
        record._show(0, first)
        return record

    def add(self, rolled: Rolled) -> None:
        """One step of all rows."""
        step, result = rolled.step, rolled.result
        self.actions[:, step] = rolled.actions
        with np.errstate(over="ignore"):  # whoever checks the episode says what was paid
            self.rewards[:, step] = result.rewards
        self.terminations[:, step] = result.terminations
        if result.successes is not None:
            if self.successes is None:
                self.successes = np.zeros(self.rewards.shape, dtype=np.bool_)
            self.successes[:, step] = result.successes
        self._show(step + 1, result.observations)
        self.lengths[rolled.running] = step + 1

    def add_play(self, actions: Float32Array, play: Play) -> None:
        """All steps of all rows."""
        self.observations[:] = play.observations
        self.observations[:, :, list(self.hidden_columns)] = 0.0
        self.actions[:] = actions
        self.rewards[:] = play.rewards
        self.terminations[:] = play.terminations
        ended = play.terminations.any(axis=1)
        self.lengths[:] = np.where(ended, play.terminations.argmax(axis=1) + 1, actions.shape[1])

    def episode(
        self, row: int, key: SeedKey, goal: FloatArray, policy: bytes, quality: int, progress: float
    ) -> Episode:
        """What the row has lived through; its arrays are its own.

        Args:
            policy: hash of who acted.
        Raises: DataError for a number that is not finite.
        """
        length = int(self.lengths[row])
        # A view would keep the whole block in memory as long as one of its episodes: copy.
        observations = self.observations[row, : length + 1].copy()
        actions = self.actions[row, :length].copy()
        rewards = self.rewards[row, :length].copy()
        _check_finite(key, observations, actions, rewards)
        truncations = np.zeros(length, dtype=np.bool_)
        truncations[-1] = length == self.actions.shape[1]
        successes = self.successes
        return Episode(
            observations=observations,
            actions=actions,
            rewards=rewards,
            terminations=self.terminations[row, :length].copy(),
            truncations=truncations,
            successes=None if successes is None else successes[row, :length].copy(),
            task=key.task,
            goal=np.asarray(goal, dtype=np.float64),
            quality=quality,
            progress=progress,
            policy=policy,
            seed_key=key.spawn_key,
        )

    def _show(self, index: int, observations: FloatArray) -> None:
        self.observations[:, index] = observations
        self.observations[:, index, list(self.hidden_columns)] = 0.0


@dataclass(frozen=True, eq=False)
class Acted:
    """Episodes that one policy acts in, one per key.

    Args:
        policy: sees the goal; its hash goes into every episode.
        keys: seed key of each row; its task is the episode's task.
        quality, progress: stored with every episode.
        clip: False for TTA sets, whose file keeps the drawn numbers and whose simulator
            clips inside its own step.
        goal_keys: what each row's goal is drawn from, where goals are shared by episodes;
            default: its own key.
    """

    policy: Policy
    keys: Sequence[SeedKey]
    quality: int
    progress: float
    clip: bool = True
    goal_keys: Sequence[SeedKey] | None = None


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
    """Run one episode per key and return them in the order of the keys; see `run_blocks`."""
    acted = Acted(policy, keys, quality, progress, clip, goal_keys)
    (episodes,) = run_blocks(
        env, [acted], horizon=horizon, hidden_columns=hidden_columns, width=width
    )
    return episodes


def run_blocks(
    env: BatchEnv,
    blocks: Sequence[Acted],
    *,
    horizon: int,
    hidden_columns: Sequence[int] = (),
    width: int | None = None,
) -> list[list[Episode]]:
    """Run the episodes of some blocks side by side; no block knows of the others.

    Args:
        env: as many rows as there are keys.
        horizon: steps, at least 1; an episode that reaches it is truncated.
        hidden_columns: observation columns stored as 0 (the policies still see them).
        width: rows a policy is evaluated at, padded with copies of its first one. A policy
            network gives other last bits at other batch widths, and contacts amplify that,
            so a short last block must use the width of the full ones. Rows of an env do not
            see each other, so padding never needs simulating.

    A policy whose actions depend on nothing it sees is run natively where the env can.

    Returns: by block, its episodes of 1 to `horizon` steps.

    Raises: DataError if the simulator returned a number that is not finite.
    """
    keys = [key for block in blocks for key in block.keys]
    assert len(keys) == env.num_rows, "one key per row"
    assert len({id(block.policy) for block in blocks}) == len(blocks), "a policy per block"
    assert horizon >= 1
    goals = env.draw_goals([key for block in blocks for key in block.goal_keys or block.keys])
    observations = env.reset(keys, goals)
    ends = np.cumsum([len(block.keys) for block in blocks]).tolist()
    parts = [slice(end - len(block.keys), end) for end, block in zip(ends, blocks, strict=True)]
    for block, rows in zip(blocks, parts, strict=True):
        padding, last = max(0, (width or 0) - len(block.keys)), block.keys[-1]
        extra = [last.at_row(last.row + 1 + row) for row in range(padding)]
        own = goals[rows]
        block.policy.begin(Rows([*block.keys, *extra], [*own, *own[-1:] * padding], horizon))
    record = Record.of(observations, env.action_size, horizon, hidden_columns)
    low, high = env.low.astype(np.float32), env.high.astype(np.float32)

    def stored(block: Acted, actions: npt.NDArray[np.floating[Any]]) -> Float32Array:
        cast = actions[: len(block.keys)].astype(np.float32)
        return np.clip(cast, low, high) if block.clip else cast

    def filled(rows: FloatArray) -> FloatArray:
        padding = max(0, (width or 0) - len(rows))
        return np.concatenate([rows, np.repeat(rows[:1], padding, axis=0)]) if padding else rows

    only = blocks[0].policy
    if len(blocks) == 1 and isinstance(only, OpenLoopPolicy) and isinstance(env, PlaysAhead):
        actions = stored(blocks[0], only.all_actions())
        record.add_play(actions, env.play(actions))
    else:
        joint = {
            n: block.policy for n, block in enumerate(blocks)
            if isinstance(block.policy, JoiningPolicy)
        }  # fmt: skip

        def choose(
            step: int, seen: FloatArray, rewards: FloatArray | None, running: BoolArray
        ) -> Float32Array:
            shown = [filled(seen[rows]) for rows in parts]
            answers: dict[int, npt.NDArray[np.floating[Any]]] = {}
            if len(joint) > 1:
                asked = list(joint.values())
                found = asked[0].act_all(step, asked, [shown[n] for n in joint])
                answers = dict(zip(joint, found, strict=True))
            chosen = []
            for number, (block, rows) in enumerate(zip(blocks, parts, strict=True)):
                if number not in answers:
                    paid = None if rewards is None else filled(rewards[rows])
                    answers[number] = block.policy.act(step, shown[number], paid)
                chosen.append(stored(block, answers[number]))
            return np.concatenate(chosen)

        for rolled in roll_out(env, observations, choose, horizon):
            record.add(rolled)
    return [
        [
            record.episode(
                row, keys[row], goals[row], block.policy.info.hash, block.quality, block.progress
            )
            for row in range(rows.start, rows.stop)
        ]
        for block, rows in zip(blocks, parts, strict=True)
    ]


def _check_finite(key: SeedKey, *arrays: Float32Array) -> None:
    for name, array in zip(("observations", "actions", "rewards"), arrays, strict=True):
        if not np.isfinite(array).all():
            step = int(np.flatnonzero(~np.isfinite(array).reshape(len(array), -1).all(axis=1))[0])
            raise DataError(
                f"the simulator left the finite numbers: {name} at step {step}",
                where=f"task {key.task}, quality {key.quality}, block {key.block}, row {key.row}",
                hint="a policy with such large actions cannot be recorded; report task and seed",
            )
