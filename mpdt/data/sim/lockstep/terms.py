"""Terms that Meta-World's rewards are made of, for B rows at once, with the bits of its scalars.

What is + - * / and a square root has one answer, of arrays or of single numbers. Three things
have not, and are done here as Meta-World's own code does them:

    powers     C's `pow(x, 2.0)` of each number; numpy squares an array by x * x
    lengths    a dot product of BLAS per row; a written-out sum may round differently
    log, exp   of each number alone; numpy's loops over arrays may use other instructions

Meta-World also mixes precisions: the gripper's effort is a float32, and what is computed from it
stays one, in some rows and steps and not in others; see `Mixed`.

Source of the slow twins: Farama-Foundation/Metaworld 3.1.1, `utils/reward_utils.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

_WORTH = 0.1  # of a tolerance at its margin
_LONG_TAIL = math.sqrt(1 / _WORTH - 1)
_GAUSSIAN = float(np.sqrt(-2 * np.log(_WORTH)))


def each(function: Callable[[Any], Any], numbers: FloatArray) -> FloatArray:
    """`function` of one number at a time, (B,)."""
    return np.array([function(number) for number in numbers], dtype=np.float64)


def square(numbers: FloatArray) -> FloatArray:
    """C's `pow(x, 2.0)`, (B,)."""
    return np.array([number**2.0 for number in numbers.tolist()])


def length(vectors: FloatArray) -> FloatArray:
    """`np.linalg.norm` of each row, (B, n) -> (B,)."""
    rows = np.ascontiguousarray(vectors)
    found: FloatArray = np.sqrt(np.vecdot(rows, rows))
    return found


def level_log(distance: FloatArray, threshold: float, slope: float, height: float) -> FloatArray:
    """slope * log(distance - threshold) + height, and 0 up to the threshold: (B,)."""
    floor = np.zeros(len(distance))
    beyond = distance > threshold
    floor[beyond] = slope * each(np.log, distance[beyond] - threshold) + height
    return floor


def tolerance(
    x: FloatArray,
    bounds: tuple[float, float],
    margin: FloatArray | float,
    *,
    gaussian: bool = False,
) -> FloatArray:
    """1 within the bounds, 0.1 at `margin` from them, falling with a long tail or as a Gaussian.

    Raises: ValueError for a negative margin, as the published one.
    """
    lower, upper = bounds
    away = np.maximum(lower - x, x - upper).tolist()
    margins = margin.tolist() if isinstance(margin, np.ndarray) else [margin] * len(away)
    if margins and min(margins) < 0:
        raise ValueError(f"`margin` must be non-negative. Current value: {min(margins)}")
    worth = _gaussian if gaussian else _long_tail
    # Plain numbers: a block is too short for arrays to pay, and powers are taken one by one.
    return np.array([1.0 if a <= 0 else worth(a, m) if m else 0.0
                     for a, m in zip(away, margins, strict=True)])  # fmt: skip


def _long_tail(away: float, margin: float) -> float:
    squared: float = (away / margin * _LONG_TAIL) ** 2.0
    return 1.0 / (squared + 1)


def _gaussian(away: float, margin: float) -> float:
    return float(np.exp(-0.5 * (away / margin * _GAUSSIAN) ** 2.0))


@dataclass(frozen=True, eq=False)
class Mixed:
    """Numbers (B,) of which Meta-World holds some as float32; `narrow` (B,) says which.

    With a float32 a Python number gives a float32. Operands without a mask are what Meta-World
    holds as Python numbers. Where no row is narrow plain arrays are used instead.
    """

    values: FloatArray
    narrow: BoolArray

    __array_ufunc__ = None  # an array on the left leaves the answer to us

    def _with(self, other: Any, take: Callable[[Any, Any], Any]) -> Mixed:
        narrow, theirs = self.narrow, other
        if isinstance(other, Mixed):
            narrow, theirs = narrow | other.narrow, other.values
        tight = take(np.float32(self.values), np.float32(theirs))
        return Mixed(np.where(narrow, tight, take(self.values, theirs)), narrow)

    def __add__(self, other: Any) -> Mixed:
        return self._with(other, np.add)

    def __sub__(self, other: Any) -> Mixed:
        return self._with(other, np.subtract)

    def __mul__(self, other: Any) -> Mixed:
        return self._with(other, np.multiply)

    def __truediv__(self, other: Any) -> Mixed:
        return self._with(other, np.divide)

    __radd__, __rmul__ = __add__, __mul__

    def over(self, whole: Mixed) -> Mixed:
        """The quotient, 0 where `whole` is not positive."""
        return self._with(whole, _over)


Numbers = FloatArray | Mixed


def _over(part: Any, whole: Any) -> Any:
    return np.divide(part, whole, out=np.zeros_like(part), where=whole > 0)


def values(numbers: Numbers) -> FloatArray:
    """All of them in float64."""
    return numbers.values if isinstance(numbers, Mixed) else numbers


def either(condition: BoolArray, this: Numbers | float, that: Numbers | float) -> Any:
    """`this` where the condition holds, `that` elsewhere."""
    if not isinstance(this, Mixed) and not isinstance(that, Mixed):
        return np.where(condition, this, that)
    (a, first), (b, second) = (
        (part.values, part.narrow) if isinstance(part, Mixed) else (part, False)
        for part in (this, that)
    )
    return mixed(np.where(condition, a, b), np.where(condition, first, second))


def mixed(numbers: FloatArray, narrow: BoolArray) -> Any:
    """`Mixed`, or the numbers themselves where none is narrow."""
    return Mixed(numbers, narrow) if narrow.any() else numbers


def add_wide(numbers: Numbers, part: FloatArray, where: BoolArray) -> Any:
    """The sum with `part`, which in the rows `where` is a numpy float64 and so widens it."""
    return either(where, values(numbers) + part, numbers + part)


@overload
def hamacher(a: FloatArray, b: FloatArray) -> FloatArray: ...
@overload
def hamacher(a: Numbers, b: Numbers) -> Numbers: ...
def hamacher(a: Any, b: Any) -> Any:
    """a b / (a + b - a b), (B,), and 0 where that is 0 / 0."""
    if isinstance(a, Mixed) or isinstance(b, Mixed):
        product = a * b
        return product.over(a + b - product)
    return np.array([_hamacher(x, y) for x, y in zip(a.tolist(), b.tolist(), strict=True)])


def _hamacher(a: float, b: float) -> float:
    product = a * b
    whole = a + b - product
    return product / whole if whole > 0 else 0.0


def effort_share(effort: npt.NDArray[np.float32], wanted: float) -> Numbers:
    """How closed the action wants the gripper, 0 to 1 at `wanted`: (B,).

    `min(max(0, effort), wanted) / wanted`, which is a float32 only between its two ends.
    """
    narrow = (effort > 0) & ~(effort > np.float32(wanted))
    ends = np.where(effort > 0, 1.0, 0.0)
    found: Numbers = mixed(np.where(narrow, effort / np.float32(wanted), ends), narrow)
    return found
