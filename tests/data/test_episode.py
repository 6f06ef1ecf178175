from dataclasses import replace

import numpy as np
import pytest
from makers import make_episode

from mpdt.data.episode import QUALITY_CODES, Episode, returns_to_go
from mpdt.errors import DataError, ShapeError


def episode(**changes) -> Episode:
    """Three steps, D = 2, A = 1, ended by the horizon."""
    columns = {
        "rewards": np.array([1, 2, 3.5], np.float32),
        "successes": np.array([False, True, False]),
        "progress": 1.0,
    }
    return make_episode(3, quality=2, row=5, **(columns | changes))


def test_quality_codes_are_those_of_the_format():
    codes = {"random": 0, "medium": 1, "expert": 2, "history": 3, "policy": 13}
    assert codes == QUALITY_CODES


def test_length_return_success():
    made = episode()
    assert (made.length, made.episode_return, made.success) == (3, 6.5, True)
    assert not replace(made, successes=None).success
    assert not replace(made, successes=np.zeros(3, bool)).success


def test_return_is_summed_in_float64():
    # In float32, 2^24 + 1 is 2^24 again: the ones would be lost.
    rewards = np.array([2**24, 1, 1], np.float32)
    assert episode(rewards=rewards).episode_return == 2**24 + 2


def test_both_end_flags_may_be_set_at_the_end():
    last = np.array([False, False, True])
    assert episode(terminations=last, truncations=last).length == 3


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"observations": np.zeros((3, 2), np.float32)}, "observations 3"),
        ({"observations": np.zeros((4, 2))}, r"wrong observations; .* of float64"),
        ({"actions": np.zeros(3, np.float32)}, r"wrong actions; expected 2 axes"),
        ({"actions": np.zeros((4, 1), np.float32)}, "actions 4"),
        ({"rewards": [1.0, 2.0, 3.0]}, "wrong rewards; .* found list"),
        ({"terminations": np.zeros(3, np.int8)}, "wrong terminations"),
        ({"successes": np.zeros(2, bool)}, "successes 2"),
        ({"goal": np.zeros(1, np.float32)}, "wrong goal"),
    ],
)
def test_wrong_shapes_and_dtypes(changes, what):
    with pytest.raises(ShapeError, match=what):
        episode(**changes)


def test_an_episode_has_a_step():
    empty = {
        "observations": np.zeros((1, 2), np.float32), "actions": np.zeros((0, 1), np.float32),
        "rewards": np.zeros(0, np.float32), "terminations": np.zeros(0, bool),
        "truncations": np.zeros(0, bool), "successes": None,
    }  # fmt: skip
    with pytest.raises(ShapeError, match="at least one step"):
        episode(**empty)


@pytest.mark.parametrize("ends", [[0, 0, 0], [1, 0, 1], [0, 1, 0]])
def test_exactly_the_last_row_ends_it(ends):
    with pytest.raises(DataError, match=r"episode \(0, 0, 2, 0, 5\): an episode ends exactly once"):
        episode(truncations=np.array(ends, bool))


def test_numbers_out_of_range():
    with pytest.raises(DataError, match="31 bytes"):
        episode(policy=bytes(31))
    with pytest.raises(DataError, match="progress out of range"):
        episode(progress=1.01)
    assert episode(progress=-1.0).progress == -1.0


def test_returns_to_go_by_hand():
    found = returns_to_go(np.array([1, 2, 3], np.float32))
    assert found.tolist() == [6, 5, 3]
    assert found.dtype == np.float32


def test_returns_to_go_sum_in_float64():
    # Suffix sums 2^24+2, 2, 1; adding the ones to 2^24 one by one in float32 would lose both.
    assert returns_to_go(np.array([2**24, 1, 1], np.float32)).tolist() == [2**24 + 2, 2, 1]
    ones_first = np.array([1, 1, 2**24], np.float32)
    assert returns_to_go(ones_first)[0] == 2**24 + 2


def test_returns_to_go_need_rewards():
    with pytest.raises(ShapeError, match="need rewards"):
        returns_to_go(np.zeros(0, np.float32))
