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
    (a, b, c), (d, e, f), (g, h, i) = m
    trace = a + e + i
    largest = max(a, e, i, trace)
    # Of equal values the first is taken, as argmax does.
    if a == largest:
        q = (1 - trace + 2 * a, d + b, g + c, h - f)
    elif e == largest:
        q = (d + b, 1 - trace + 2 * e, h + f, c - g)
    elif i == largest:
        q = (g + c, h + f, 1 - trace + 2 * i, d - b)
    else:
        q = (h - f, c - g, d - b, 1 + trace)
    x, y, z, w = q
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return (x / norm, y / norm, z / norm, w / norm)
