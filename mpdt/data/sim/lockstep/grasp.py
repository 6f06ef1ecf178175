"""How well the gripper holds a thing, 0 to 1: the terms that most rewards share.

    caged     the pads on both sides of the thing, against where it started; fingers around it
    pinched   the pads on both sides of the thing where it is now; no effort of the gripper

Both multiply (t-norm of Hamacher) a term along y, across the pads, with one in the plane x, z.

Source of the slow twins: Farama-Foundation/Metaworld 3.1.1, `_gripper_caging_reward` of
`SawyerXYZEnv` and of the envs that have their own.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from mpdt.data.sim.lockstep.scene import Scene
from mpdt.data.sim.lockstep.terms import (
    FloatArray,
    Numbers,
    effort_share,
    either,
    hamacher,
    length,
    tolerance,
)

_PLANE = [0, 2]  # x and z

Density = Literal["", "high", "medium"]


def caged(
    scene: Scene,
    thing: FloatArray,
    *,
    radius: float,
    pads: float,
    plane: float,
    reach: float = 0.01,
    effort: float = 1.0,
    density: Density = "high",
    start: FloatArray | None = None,
) -> Numbers:
    """Of a thing (B, 3), (B,).

    Args:
        radius, pads: the pads count as on both sides at distances between these, m.
        plane: the fingers count as around it up to this distance in x, z.
        reach: the same in space, for the density "medium".
        effort: of the gripper that counts as closed.
        density: what joins the product: the cage, or how near the fingers are.
        start: where the thing was at the reset; default: the scene's.
    """
    start = scene.start if start is None else start
    sides = [
        tolerance(np.abs(y - thing[:, 1]), (radius, pads), np.abs(np.abs(y - start[:, 1]) - pads))
        for y in _pads(scene)
    ]
    fingers, first = scene.fingers, scene.kept("init_tcp")
    margin = scene.once("cage", lambda: length((start - first)[:, _PLANE]) - plane)
    around = tolerance(length((fingers - thing)[:, _PLANE]), (0, plane), margin)
    held, cage = _closed(scene, hamacher(hamacher(*sides), around), effort)
    if density == "high":
        return (held + cage) / 2
    if density == "medium":
        margin = scene.once("reach", lambda: np.abs(length(start - first) - reach))
        return (held + tolerance(length(thing - fingers), (0, reach), margin)) / 2
    return held


def caged_between(scene: Scene, thing: FloatArray) -> Numbers:
    """`caged` as pick-place has it: along y against where the thing is now."""
    cage = hamacher(_between(scene, thing, 0.015, 0.05), _around(scene, thing, 0.005))
    held, cage = _closed(scene, cage, 1.0)
    return (held + cage) / 2


def pinched(
    scene: Scene, thing: FloatArray, *, radius: float, slack: float, plane: float
) -> FloatArray:
    """Of a thing (B, 3), (B,): how well it is caged, and once it is, how tight the pads are.

    Args:
        slack: of the pads beyond `radius`, m.
    """
    cage = hamacher(_between(scene, thing, radius, 0.05), _around(scene, thing, plane))
    tight = _between(scene, thing, radius, radius + slack)
    return (cage + np.where(cage > 0.95, tight, 0.0)) / 2


def _pads(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """y of the left and the right pad."""
    return scene.body("leftpad")[:, 1], scene.body("rightpad")[:, 1]


def _closed(scene: Scene, cage: FloatArray, effort: float) -> tuple[Numbers, FloatArray]:
    closed = either(cage > 0.97, effort_share(scene.effort, effort), 0.0)
    return hamacher(closed, cage), cage


def _between(scene: Scene, thing: FloatArray, radius: float, outer: float) -> FloatArray:
    y = thing[:, 1]
    left, right = _pads(scene)
    # Meta-World means the pads at the reset, but what it keeps of them is a view that moves along.
    sides = [
        tolerance(gap, (radius, outer), np.abs(np.abs(y - pad) - 0.05))
        for gap, pad in ((y - right, right), (left - y, left))
    ]
    return hamacher(*sides)


def _around(scene: Scene, thing: FloatArray, plane: float) -> FloatArray:
    first = scene.kept("init_tcp")
    margin = scene.once("cage", lambda: length(_level(scene.start) - _level(first)) - plane)
    return tolerance(length(_level(scene.fingers) - _level(thing)), (0, plane), margin)


def _level(points: FloatArray) -> FloatArray:
    """With y = 0."""
    level = points.copy()
    level[:, 1] = 0.0
    return level
