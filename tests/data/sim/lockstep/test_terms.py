from __future__ import annotations

import numpy as np
import pytest
from metaworld.utils import reward_utils
from scipy.spatial.transform import Rotation

from mpdt.data.sim import rotation
from mpdt.data.sim.lockstep.terms import (
    Mixed,
    add_wide,
    effort_share,
    either,
    hamacher,
    length,
    level_log,
    tolerance,
)


def numbers(*shape):
    return np.random.default_rng(0).normal(size=shape)


def test_tolerance_by_hand():
    """0.3 above the upper bound is once the margin: there it is worth 0.1."""
    found = tolerance(np.array([0.5, 1.3, -0.3]), (0, 1), 0.3)
    np.testing.assert_allclose(found, [1.0, 0.1, 0.1])
    assert tolerance(np.array([1.0, 1.5]), (0, 1), 0.0).tolist() == [1.0, 0.0]
    with pytest.raises(ValueError, match="non-negative"):
        tolerance(np.array([1.0, 1.5]), (0, 1), np.array([1.0, -0.1]))


@pytest.mark.parametrize("gaussian", [False, True])
def test_tolerance_has_the_bits_of_the_published_one(gaussian):
    x, margin = numbers(2, 3000) ** 2
    kind = "gaussian" if gaussian else "long_tail"
    wanted = [
        reward_utils.tolerance(a, (0.1, 0.3), b, kind)
        for a, b in zip(x.tolist(), margin, strict=True)
    ]
    found = tolerance(x, (0.1, 0.3), margin, gaussian=gaussian)
    assert found.tobytes() == np.array(wanted).tobytes()


@pytest.mark.parametrize("size", [1, 2, 3, 4])
def test_lengths_have_the_bits_of_numpys_norm(size):
    vectors = numbers(1000, 4)[:, :size]  # a slice, whose rows lie apart
    wanted = np.array([np.linalg.norm(vector.copy()) for vector in vectors])
    assert length(vectors).tobytes() == wanted.tobytes()


def test_a_log_above_a_threshold():
    found = level_log(np.array([0.02, 0.03, 0.03 + np.e]), 0.03, 0.5, 2.0)
    np.testing.assert_allclose(found, [0.0, 0.0, 2.5])


def test_hamacher_has_the_bits_of_the_published_one():
    a, b = np.random.default_rng(0).uniform(0, 1, (2, 1000))
    a[:3], b[:3] = (0, 0, 1), (0, 1, 1)
    wanted = [reward_utils.hamacher_product(*pair) for pair in zip(a.tolist(), b.tolist(),
                                                                   strict=True)]  # fmt: skip
    assert hamacher(a, b).tobytes() == np.array(wanted, np.float64).tobytes()


def test_efforts_are_a_float32_between_their_ends_only():
    effort = np.array([-1.0, 0.0, 0.35, 0.7, 0.71, 1.0], np.float32)
    share = effort_share(effort, 0.7)
    assert share.narrow.tolist() == [False, False, True, True, False, False]
    wanted = [min(max(0, one), 0.7) / 0.7 for one in effort]  # as published
    assert share.values.tolist() == [float(number) for number in wanted]


def test_mixed_numbers_are_what_numpy_and_python_make_of_scalars():
    """A reward like push-wall's, of a float32 in half of the rows and of Python's in the rest."""
    a, b = np.random.default_rng(1).uniform(0, 1, (2, 600))
    narrow = np.arange(600) % 2 == 0
    held = Mixed(np.where(narrow, a.astype(np.float32), a), narrow)

    def reward(held, near, product):
        return 1.0 + 2 * product(held, near) + 5.0 * near + (held + near) / 3

    found = reward(held, b, hamacher)
    wanted = []
    for one, is_narrow, near in zip(held.values.tolist(), narrow, b.tolist(), strict=True):
        scalar = np.float32(one) if is_narrow else one
        wanted.append(reward(scalar, near, reward_utils.hamacher_product))
    assert {type(number) for number in wanted} == {float, np.float32}
    assert found.values.tobytes() == np.array(wanted, np.float64).tobytes()
    assert found.narrow.tolist() == narrow.tolist()
    # a numpy number widens the sum where it meets one
    wide = add_wide(held, b, ~narrow | (a > 0.5))
    assert wide.narrow.tolist() == (narrow & (a <= 0.5)).tolist()
    np.testing.assert_array_equal(wide.values[a > 0.5], (held.values + b)[a > 0.5])
    # who is not chosen leaves nothing behind
    assert either(np.ones(600, np.bool_), 10.0, found).tolist() == [10.0] * 600


def test_quaternions_of_many_are_those_of_each(monkeypatch):
    quaternions = numbers(500, 4)
    rounded = quaternions.round()  # half and quarter turns, where two diagonal entries are equal
    quaternions = np.concatenate([quaternions, rounded[rounded.any(axis=1)]])
    matrices = np.array([Rotation.from_quat(q).as_matrix() for q in quaternions])
    wanted = Rotation.from_matrix(matrices).as_quat()
    doubtful = matrices[:2] + 1e-6
    scipys = [Rotation.from_matrix(matrix).as_quat() for matrix in doubtful]
    assert rotation.quaternions(doubtful).tobytes() == np.array(scipys).tobytes()
    monkeypatch.setattr(Rotation, "from_matrix", None)
    assert rotation.quaternions(matrices).tobytes() == wanted.tobytes()
