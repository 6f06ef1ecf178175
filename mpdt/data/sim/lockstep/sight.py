"""What scripts look at and how they decide, for B rows at once.

    see.hand, see.first, see.goal    (B, 3) out of observations (B, 39)
    choose(otherwise, (condition, aim), ...)    per row the aim of the first condition that holds

A script answers with an aim of the hand, a gain and an effort: `Move`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mpdt.data.sim.lockstep.scene import shifted
from mpdt.data.sim.lockstep.terms import BoolArray, FloatArray, length

_PLANE = [0, 2]  # x and z


class Sight:
    """Observations (B, 39) by name."""

    def __init__(self, observations: FloatArray) -> None:
        self.hand, self.opening = observations[:, :3], observations[:, 3]
        self.first, self.second = observations[:, 4:7], observations[:, 11:14]
        self.goal = observations[:, 36:39]


@dataclass(frozen=True, eq=False)
class Move:
    """Args: aim (B, 3) of the hand; gain 1 / cm or one per row; effort of the gripper."""

    aim: FloatArray
    gain: FloatArray | float
    effort: FloatArray | float


Script = Callable[[Sight], Move]


def answer(script: Script, observations: FloatArray) -> npt.NDArray[np.float32]:
    """Actions (B, 4) of a script, not clipped; float32, as Meta-World's scripts answer."""
    see = Sight(observations)
    move = script(see)
    actions = np.empty((len(observations), 4), np.float32)
    gain = move.gain if isinstance(move.gain, float) else move.gain[:, None]
    actions[:, :3] = gain * (move.aim - see.hand)
    actions[:, 3] = move.effort
    return actions


def choose(otherwise: FloatArray, *cases: tuple[BoolArray, FloatArray]) -> FloatArray:
    """Points (B, 3)."""
    chosen = otherwise
    for condition, aim in reversed(cases):
        chosen = np.where(condition[:, None], aim, chosen)
    return chosen


def at(x: FloatArray | float, y: FloatArray | float, z: FloatArray | float) -> FloatArray:
    """Points (B, 3) or (3,) of their coordinates."""
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


def far(a: FloatArray, b: FloatArray, distance: float) -> BoolArray:
    """Further apart than `distance` in x, y."""
    found: BoolArray = length((a - b)[:, :2]) > distance
    return found


def far_in_plane(a: FloatArray, b: FloatArray, distance: float) -> BoolArray:
    """Further apart than `distance` in x, z."""
    found: BoolArray = length((a - b)[:, _PLANE]) > distance
    return found


def off(a: FloatArray, b: FloatArray, distance: float, axis: int = 2) -> BoolArray:
    """Further apart than `distance` along one axis."""
    found: BoolArray = np.abs(a[:, axis] - b[:, axis]) > distance
    return found


def approach(
    see: Sight,
    thing: FloatArray,
    then: FloatArray,
    *,
    aside: float,
    over: float,
    apart: float,
    onto: float = 0.0,
) -> FloatArray:
    """Over the thing, down to it, then on: the hand's aim (B, 3).

    Args:
        aside: further than this in x, y the hand goes `over` the thing.
        apart: further than this in z it goes down, to `onto` above the thing.
    """
    return choose(
        then,
        (far(see.hand, thing, aside), shifted(thing, z=over)),
        (off(see.hand, thing, apart), shifted(thing, z=onto)),
    )


def grip(
    see: Sight, thing: FloatArray, opened: float, closed: float, *, aside: float, apart: float
) -> FloatArray:
    """The effort (B,): `closed` once the hand is at the thing."""
    away = far(see.hand, thing, aside) | off(see.hand, thing, apart)
    return np.where(away, opened, closed)
