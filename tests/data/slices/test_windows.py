"""Windows of two tiny episodes whose numbers can be checked on paper.

Episode 0 has 3 steps, episode 1 has 2. Observations are 10*episode + step (one column, T+1
rows), actions 100 + row of /steps, rewards 1 2 3 | 4 5.

    steps rows     0   1   2 |  3   4
    obs rows       0   1   2   3 |  4   5   6
    observations   0   1   2   3 | 10  11  12
    actions      100 101 102 | 103 104
    rewards        1   2   3 |   4   5
    to go          6   5   3 |   9   5
"""

from types import SimpleNamespace

import numpy as np
import pytest

from mpdt.data.slices.windows import (
    RewardReturns,
    constant_returns,
    cover,
    decreasing_returns,
    gather_windows,
)
from mpdt.errors import ShapeError

REWARDS = np.array([1, 2, 3, 4, 5], np.float32)
SOURCE = SimpleNamespace(
    steps=SimpleNamespace(
        observations=np.array([[0], [1], [2], [3], [10], [11], [12]], np.float32),
        actions=np.array([[100], [101], [102], [103], [104]], np.float32),
    ),
    episodes=SimpleNamespace(
        start=np.array([0, 3]), obs_start=np.array([0, 4]), length=np.array([3, 2])
    ),
)


def gather(episodes, starts, window, returns=None):
    returns = returns or RewardReturns(SOURCE, REWARDS)
    return gather_windows(SOURCE, np.array(episodes), np.array(starts), window, returns)


def test_full_window_by_hand():
    batch = gather([[0]], [[1]], 2)
    assert batch.observations.tolist() == [[[[1], [2]]]]
    assert batch.actions.tolist() == [[[[101], [102]]]]
    assert batch.previous_actions.tolist() == [[[[100], [101]]]]
    assert batch.returns_to_go.tolist() == [[[5, 3]]]
    assert batch.timesteps.tolist() == [[[1, 2]]]
    assert batch.mask.tolist() == [[[True, True]]]


def test_short_window_is_padded_on_the_left_and_stays_in_its_episode():
    batch = gather([[0, 1]], [[2, 0]], 3)
    assert batch.mask.tolist() == [[[False, False, True], [False, True, True]]]
    assert batch.observations[..., 0].tolist() == [[[0, 0, 2], [0, 10, 11]]]
    assert batch.actions[..., 0].tolist() == [[[0, 0, 102], [0, 103, 104]]]
    assert batch.timesteps.tolist() == [[[0, 0, 2], [0, 0, 1]]]
    assert batch.returns_to_go.tolist() == [[[0, 0, 3], [0, 9, 5]]]


def test_previous_action_of_a_first_step_is_zero_not_the_neighbour_episodes_last():
    batch = gather([[1]], [[0]], 2)
    assert batch.previous_actions[..., 0].tolist() == [[[0, 103]]]


def test_dtypes_and_plain_arrays():
    batch = gather([[0]], [[0]], 2)
    for name in ("observations", "previous_actions", "actions", "returns_to_go"):
        assert getattr(batch, name).dtype == np.float32, name
        assert type(getattr(batch, name)) is np.ndarray
    assert batch.timesteps.dtype == np.int64 and batch.mask.dtype == np.bool_


def test_constant_returns_repeat_the_wish():
    batch = gather([[1, 0]], [[0, 2]], 2, constant_returns(np.array([7.0, 9.0])))
    assert batch.returns_to_go.tolist() == [[[9, 9], [0, 7]]]


def test_decreasing_returns_subtract_what_was_paid_before():
    wish = decreasing_returns(SOURCE, np.array([10.0, 10.0]), REWARDS)
    # episode 0: 10, 10-1, 10-1-2; episode 1: 10, 10-4
    assert gather([[0, 1]], [[0, 0]], 3, wish).returns_to_go.tolist() == [[[10, 9, 7], [0, 10, 6]]]
    assert gather([[0]], [[2]], 2, wish).returns_to_go.tolist() == [[[0, 7]]]


def test_cover_holds_every_step_once():
    ids, starts = cover(SOURCE.episodes.length, np.array([1, 0]), 2)
    assert ids.tolist() == [1, 0, 0]
    assert starts.tolist() == [0, 0, 2]


@pytest.mark.parametrize("start", [-1, 3])
def test_start_outside_the_episode_is_refused(start):
    with pytest.raises(ShapeError, match=r"episode 0: .* expected a start in \[0, 3\)"):
        gather([[0]], [[start]], 2)


def test_shapes_must_agree():
    with pytest.raises(ShapeError, match="starts of windows disagree"):
        gather([[0, 1]], [[0]], 2)
