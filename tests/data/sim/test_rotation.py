from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mpdt.data.sim import rotation
from mpdt.data.sim.rotation import QuickRotation


def twin(matrix) -> bytes:
    return Rotation.from_matrix(matrix).as_quat().tobytes()


def test_a_quarter_turn_about_z():
    """x -> y, y -> -x: half the angle is 45 degrees, so z = w = sqrt(1/2)."""
    matrix = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(QuickRotation.from_matrix(matrix).as_quat(),
                               [0, 0, 0.5**0.5, 0.5**0.5], atol=1e-15)  # fmt: skip


def test_rotations_have_scipys_bytes_and_are_not_handed_on(monkeypatch):
    generator = np.random.default_rng(0)
    quaternions = generator.normal(size=(2000, 4))
    # Whole numbers: half and quarter turns, where two diagonal entries are equal.
    rounded = quaternions.round()
    quaternions = np.concatenate([quaternions, rounded[rounded.any(axis=1)]])
    matrices = [Rotation.from_quat(q).as_matrix() for q in quaternions]
    wanted = [twin(matrix) for matrix in matrices]
    monkeypatch.setattr(Rotation, "from_matrix", None)
    assert [QuickRotation.from_matrix(m).as_quat().tobytes() for m in matrices] == wanted


@pytest.mark.parametrize("by", [1e-11, 1e-6, 0.1, np.nan])
def test_what_is_no_rotation_beyond_doubt_is_scipys_business(by):
    matrix = np.eye(3)
    matrix[0, 1] = by
    assert not rotation._is_rotation(matrix.tolist())
    if np.isfinite(by):
        assert QuickRotation.from_matrix(matrix).as_quat().tobytes() == twin(matrix)


def test_a_mirror_is_refused():
    with pytest.raises(ValueError, match="determinant"):
        QuickRotation.from_matrix(np.diag([1.0, 1.0, -1.0]))
