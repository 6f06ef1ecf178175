"""QuickRotation: `scipy.spatial.transform.Rotation.from_matrix(m).as_quat()`, without its checks.

scipy asks with arrays whether a matrix is a rotation at all (35 us) and mends it if it is not.
MuJoCo's matrices are, to the last bits; that is asked here of nine plain floats. Where the answer
is not beyond doubt, scipy itself is asked, so the result is the same bit for bit either way.

Source: Markley 2008, "Unit quaternion from rotation matrix", as in scipy's `_rotation_cy.pyx`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

_DOUBT = 1e-13  # scipy corrects matrices from 1e-12 on
_EYE = np.eye(3)


class QuickRotation:
    """One rotation; made by `from_matrix` alone."""

    def __init__(self, quaternion: npt.NDArray[np.float64]) -> None:
        self._quaternion = quaternion

    @classmethod
    def from_matrix(cls, matrix: npt.NDArray[np.float64]) -> QuickRotation:
        """Of a (3, 3) matrix, which must turn and not mirror."""
        rows = matrix.tolist()
        if not _is_rotation(rows):
            from scipy.spatial.transform import Rotation

            return cls(Rotation.from_matrix(matrix).as_quat())
        return cls(np.array(_quaternion(rows)))

    def as_quat(self) -> npt.NDArray[np.float64]:
        """(x, y, z, w) of unit length, as scipy signs it."""
        return self._quaternion


def _is_rotation(m: list[list[float]]) -> bool:
    (a, b, c), (d, e, f), (g, h, i) = m
    products = (
        a * a + b * b + c * c - 1, d * d + e * e + f * f - 1, g * g + h * h + i * i - 1,
        a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i,
    )  # fmt: skip
    if not max(map(abs, products)) < _DOUBT:
        return False
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0.5


def _quaternion(m: list[list[float]]) -> Any:
    a, e, i = m[0][0], m[1][1], m[2][2]
    candidates = (a, e, i, a + e + i)
    x, y, z, w = _unscaled(m, candidates.index(max(candidates)))
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return (x / norm, y / norm, z / norm, w / norm)


def _unscaled(m: Any, largest: int) -> tuple[Any, Any, Any, Any]:
    """Of numbers or of arrays; `largest` of the diagonal and the trace, the first of equals."""
    (a, b, c), (d, e, f), (g, h, i) = m
    trace = a + e + i
    if largest == 0:
        return 1 - trace + 2 * a, d + b, g + c, h - f
    if largest == 1:
        return d + b, 1 - trace + 2 * e, h + f, c - g
    if largest == 2:
        return g + c, h + f, 1 - trace + 2 * i, d - b
    return h - f, c - g, d - b, 1 + trace


def quaternions(matrices: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(x, y, z, w) of MuJoCo's matrices (B, 3, 3), each as `QuickRotation` has it: (B, 4).

    MuJoCo makes them of quaternions, so they never mirror.
    """
    a, e, i = matrices[:, 0, 0], matrices[:, 1, 1], matrices[:, 2, 2]
    largest = np.argmax((a, e, i, a + e + i), axis=0)
    found = np.empty((len(matrices), 4))
    for case in set(largest.tolist()):
        rows = largest == case
        x, y, z, w = q = _unscaled(matrices[rows].transpose(1, 2, 0), case)
        found[rows] = (np.array(q) / np.sqrt(x * x + y * y + z * z + w * w)).T
    doubt = np.abs(matrices @ matrices.transpose(0, 2, 1) - _EYE)
    if not doubt.max(initial=0.0) < _DOUBT:
        for row in np.flatnonzero(~(doubt < _DOUBT).all(axis=(1, 2))):
            found[row] = QuickRotation.from_matrix(matrices[row]).as_quat()
    return found
