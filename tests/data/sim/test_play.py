"""run_block with numbers worked out by hand: a counter env and an adding policy.

observation  [position, secret]      position starts at the row number, secret is 9
step         position += action, reward = 10 * position after the step
terminated   when position >= 3
policy       acts 0.5 * (step + 1) in every row, for step 0, 1, 2, ...

row 0 (position 0)   actions 0.5 1.0 1.5   positions 0.5 1.5 3.0   ends at step 2: fell
row 1 (position 1)   actions 0.5 1.0 1.5   positions 1.5 2.5 4.0   ends at step 2: fell
row 2 (position 2)   actions 0.5 1.0       positions 2.5 3.5       ends at step 1: fell
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from mpdt.data.episode import Episode, PolicyInfo
from mpdt.data.sim.actors import Rows
from mpdt.data.sim.batch import StepResult
from mpdt.data.sim.play import Acted, run_block, run_blocks
from mpdt.errors import DataError
from mpdt.seeding import SeedKey


class CounterBatch:
    """The env of the module docstring; it notes every action it was given."""

    observation_size, action_size = 2, 1

    def __init__(self, rows: int, high: float = 10.0, successes: bool = False) -> None:
        self.num_rows, self.has_success = rows, successes
        self.low, self.high = np.array([-high]), np.array([high])
        self.given: list[np.ndarray[Any, Any]] = []

    def draw_goals(self, keys: Sequence[SeedKey]) -> list[Any]:
        return [np.array([100.0 + key.row]) for key in keys]

    def reset(self, keys: Sequence[SeedKey], goals: Sequence[Any]) -> Any:
        self.position = np.array([float(key.row) for key in keys])
        return self._observe()

    def _observe(self) -> Any:
        return np.stack([self.position, np.full(self.num_rows, 9.0)], axis=1)

    def step(self, actions: Any) -> StepResult:
        self.given.append(actions.copy())
        self.position = self.position + actions[:, 0].astype(np.float64)
        success = self.position >= 2.5 if self.has_success else None
        return StepResult(self._observe(), 10 * self.position, self.position >= 3, success)


class RisingPolicy:
    """0.5 * (step + 1), and it remembers what it saw."""

    info = PolicyInfo(b"\7" * 32, 0, 0, 0.0, -1, 0.0, "rising")

    def __init__(self, factor: float = 0.5) -> None:
        self.factor = factor
        self.seen: list[Any] = []

    def begin(self, rows: Rows) -> None:
        self.keys, self.goals, self.horizon = list(rows.keys), list(rows.goals), rows.horizon

    def act(self, step: int, observations: Any, rewards: Any = None) -> Any:
        self.seen.append(observations.copy())
        return np.full((len(observations), 1), self.factor * (step + 1))


def make_keys(rows: int) -> list[SeedKey]:
    return [SeedKey(5, 0, 1, 2, 3, row) for row in range(rows)]


def run(env: CounterBatch, policy: RisingPolicy, horizon: int, **options: Any) -> list[Episode]:
    keys = make_keys(env.num_rows)
    return run_block(env, policy, keys, horizon=horizon, quality=2, progress=0.25, **options)


def test_each_row_ends_at_its_own_step() -> None:
    episodes = run(CounterBatch(3), RisingPolicy(), 5)
    assert [episode.length for episode in episodes] == [3, 3, 2]
    assert episodes[0].rewards.tolist() == [5.0, 15.0, 30.0]
    assert episodes[2].rewards.tolist() == [25.0, 35.0]
    assert episodes[2].observations[:, 0].tolist() == [2.0, 2.5, 3.5]
    assert episodes[0].terminations.tolist() == [False, False, True]
    assert not any(episode.truncations.any() for episode in episodes)
    assert [episode.episode_return for episode in episodes] == [50.0, 80.0, 60.0]


def test_the_horizon_truncates_and_both_flags_may_meet() -> None:
    episodes = run(CounterBatch(3), RisingPolicy(), 2)
    assert [episode.length for episode in episodes] == [2, 2, 2]
    assert all(episode.truncations.tolist() == [False, True] for episode in episodes)
    assert [bool(episode.terminations[-1]) for episode in episodes] == [False, False, True]


def test_identity_of_an_episode_comes_from_key_goal_and_policy() -> None:
    episode = run(CounterBatch(3), RisingPolicy(), 4)[1]
    assert episode.seed_key == (0, 1, 2, 3, 1)
    assert episode.task == 1
    assert episode.goal.tolist() == [101.0]
    assert episode.policy == b"\7" * 32
    assert (episode.quality, episode.progress) == (2, 0.25)


def test_hidden_columns_are_zero_in_the_file_and_visible_to_the_policy() -> None:
    policy = RisingPolicy()
    episodes = run(CounterBatch(2), policy, 3, hidden_columns=(1,))
    assert all((episode.observations[:, 1] == 0).all() for episode in episodes)
    assert all((seen[:, 1] == 9).all() for seen in policy.seen)
    assert episodes[0].observations[1, 0] == 0.5  # the other column stays


def test_the_env_is_given_exactly_what_is_stored() -> None:
    env = CounterBatch(1, high=0.7)
    episode = run(env, RisingPolicy(factor=1 / 3), 4)[0]
    given = np.concatenate(env.given)
    assert given.dtype == episode.actions.dtype == np.float32
    assert given.tobytes() == episode.actions.tobytes()
    # 1/3, 2/3, then 1 and 4/3 clipped to float32(0.7)
    assert (
        episode.actions[:, 0].tolist()
        == [np.float32(1 / 3), np.float32(2 / 3)] + [np.float32(0.7)] * 2
    )


def test_tta_sets_keep_the_drawn_numbers() -> None:
    env = CounterBatch(1, high=0.7)
    episode = run(env, RisingPolicy(), 2, clip=False)[0]
    assert episode.actions[:, 0].tolist() == [0.5, 1.0]
    assert np.concatenate(env.given)[:, 0].tolist() == [0.5, 1.0]


def test_a_short_block_shows_the_policy_its_full_width() -> None:
    env, policy = CounterBatch(2), RisingPolicy()
    episodes = run(env, policy, 3, width=5)
    assert len(episodes) == 2
    assert {seen.shape for seen in policy.seen} == {(5, 2)}
    assert {given.shape for given in env.given} == {(2, 1)}
    assert [key.row for key in policy.keys] == [0, 1, 2, 3, 4]
    assert len(policy.goals) == 5


class MixingPolicy(RisingPolicy):
    """A matrix product, so that the batch width could matter."""

    def act(self, step: int, observations: Any, rewards: Any = None) -> Any:
        weights = np.linspace(-0.4, 0.9, 2, dtype=np.float32)[:, None]
        return np.tanh(observations.astype(np.float32) @ weights)


def test_padding_equals_simulating_the_padded_rows() -> None:
    """Slow twin: run all five rows and drop three."""
    fast = run(CounterBatch(2), MixingPolicy(), 6, width=5)
    slow = run(CounterBatch(5), MixingPolicy(), 6)[:2]
    for left, right in zip(fast, slow, strict=True):
        assert left.observations.tobytes() == right.observations.tobytes()
        assert left.actions.tobytes() == right.actions.tobytes()


def test_successes_only_where_the_env_has_them() -> None:
    assert run(CounterBatch(1), RisingPolicy(), 3)[0].successes is None
    with_success = run(CounterBatch(3, successes=True), RisingPolicy(), 3)
    found = [e.successes.tolist() for e in with_success if e.successes is not None]
    assert found == [[False, False, True], [False, True, True], [True, True]]


def test_numbers_that_are_not_finite_stop_the_block() -> None:
    class Exploding(CounterBatch):
        def step(self, actions: Any) -> StepResult:
            result = super().step(actions)
            if len(self.given) == 2:
                result.rewards[1] = np.nan
            return result

    with pytest.raises(DataError, match=r"row 1: .*rewards at step 1"):
        run(Exploding(3), RisingPolicy(), 3)


def test_no_global_generator_is_touched() -> None:
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    run(CounterBatch(2), RisingPolicy(), 3)
    assert (np.random.get_state()[1] == before).all()  # noqa: NPY002


def test_blocks_side_by_side_do_not_know_of_each_other() -> None:
    """Two rows that rise by halves, and one by ones: each policy is shown its own, padded to 3."""
    keys, slow, fast = make_keys(3), RisingPolicy(), RisingPolicy(1.0)
    blocks = [Acted(slow, keys[:2], 0, 0.0), Acted(fast, keys[2:], 1, 1.0)]
    first, second = run_blocks(CounterBatch(3), blocks, horizon=2, width=3)
    assert [e.actions[:, 0].tolist() for e in [*first, *second]] == [[0.5, 1.0]] * 2 + [[1.0]]
    assert [(e.quality, e.progress) for e in [*first, *second]] == [(0, 0.0)] * 2 + [(1, 1.0)]
    assert slow.seen[0][:, 0].tolist() == [0, 1, 0] and slow.seen[1][:, 0].tolist() == [
        0.5,
        1.5,
        0.5,
    ]
    assert fast.seen[0][:, 0].tolist() == [2, 2, 2]
    assert [float(goal[0]) for goal in slow.goals] == [100, 101, 101]
    assert [float(goal[0]) for goal in fast.goals] == [102, 102, 102]
    assert [key.row for key in fast.keys] == [2, 3, 4] and fast.keys[0] == keys[2]
