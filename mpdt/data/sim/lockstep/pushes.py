"""Rewards of what is pushed over the table: pucks, plates, balls, the mug; and of the sticks
that push or pull something else.

Formulas: Farama-Foundation/Metaworld 3.1.1, `envs/`, reward version 2.
"""

from __future__ import annotations

import numpy as np

from mpdt.data.sim.lockstep.grasp import caged, pinched
from mpdt.data.sim.lockstep.scene import (
    UNTURNED,
    Rules,
    Scene,
    Score,
    body,
    body_matrix_turn,
    body_turn,
    geom,
    geom_turn,
    shifted,
    site,
)
from mpdt.data.sim.lockstep.terms import (
    BoolArray,
    FloatArray,
    either,
    hamacher,
    length,
    tolerance,
)


def _push(scene: Scene) -> Score:
    thing, target = scene.thing, scene.target
    short = length(thing - target)
    near = tolerance(short, (0, 0.05), length(scene.start - target))
    held = caged(scene, thing, radius=0.015, pads=0.05, plane=0.005)
    reward = 2 * held
    at = (length(thing - scene.fingers) < 0.02) & (scene.opening > 0)
    reward = either(at, reward + (1.0 + reward + 5.0 * near), reward)
    return either(short < 0.05, 10.0, reward), short <= 0.05


def _push_wall(scene: Scene) -> Score:
    thing, target, start = scene.thing, scene.target, scene.start
    scale, middle = np.array([3.0, 1.0, 1.0]), thing.copy()
    middle[:, :2] = -0.05, 0.77
    short = length(thing - target)
    margin = length((start - middle) * scale)
    half = tolerance(length((thing - middle) * scale), (0, 0.05), margin)
    near = tolerance(short, (0, 0.05), scene.way)
    held = caged(scene, thing, radius=0.015, pads=0.05, plane=0.005)
    at = (length(thing - scene.fingers) < 0.02) & (scene.opening > 0)
    reward = either(at, 2.0 * held + 1.0 + 4.0 * half, 2 * held)
    past = at & (thing[:, 1] > 0.75)
    reward = either(past, 2 * held + 1.0 + 4.0 + 3.0 * near, reward)
    return either(short < 0.05, 10.0, reward), short <= 0.07


def _push_back(scene: Scene) -> Score:
    thing, target = scene.thing, scene.target
    short, way = length(thing - target), length(scene.start - target)
    near = tolerance(short, (0, 0.05), way)
    held = pinched(scene, thing, radius=0.007, slack=0.003, plane=0.01)
    reward = hamacher(held, near)
    at = (length(thing - scene.fingers) < 0.01) & (scene.opening > 0) & (scene.opening < 0.55)
    at &= way - short > 0.01
    reward = np.where(at, reward + (1.0 + 5.0 * near), reward)
    return np.where(short < 0.05, 10.0, reward), short <= 0.07


def _swept(scene: Scene, target: FloatArray, held: FloatArray) -> Score:
    short = length(scene.thing - target)
    near = tolerance(short, (0, 0.05), length(scene.start - target))
    reward = 2 * held + 6 * hamacher(held, near)
    return np.where(short < 0.05, 10.0, reward), short <= 0.05


def _sweep(scene: Scene) -> Score:
    held = pinched(scene, scene.thing, radius=0.02, slack=0.01, plane=0.005)
    return _swept(scene, scene.target, held)


def _sweep_into(scene: Scene) -> Score:
    target = scene.target.copy()
    target[:, 2] = scene.thing[:, 2]
    held = pinched(scene, scene.thing, radius=0.02, slack=0.005, plane=0.01)
    return _swept(scene, target, held)


def _soccer(scene: Scene) -> Score:
    thing, target, scale = scene.thing, scene.target, np.array([3.0, 1.0, 1.0])
    away = length((thing - target) * scale)
    near = tolerance(away, (0, 0.07), length((thing - scene.start) * scale))
    line = target[:, 1] - 0.1
    beside = (thing[:, 1] > line) & (np.abs(thing[:, 0] - target[:, 0]) > 0.1)
    lost = near - 2 * ((thing[:, 1] - line) / (1 - line))
    near = np.where(beside, lost.clip(0.0, 1.0), near)
    held = pinched(scene, thing, radius=0.013, slack=0.01, plane=0.005)
    reward = 3 * held + 6.5 * near
    return np.where(away < 0.07, 10.0, reward), length(thing - target) <= 0.07


def _mug(scene: Scene) -> Score:
    thing, target, scale = scene.thing, scene.target, np.array([2.0, 2.0, 1.0])
    away = length((thing - target) * scale)
    near = tolerance(away, (0, 0.05), length((scene.start - target) * scale))
    held = caged(
        scene, thing, radius=0.02, pads=0.05, plane=0.05, reach=0.04, effort=0.7, density="medium"
    )
    reward = hamacher(held, near)
    at = (length(thing - scene.fingers) < 0.04) & (scene.opening > 0)
    reward = either(at, reward + (1.0 + 5.0 * near), reward)
    return either(away < 0.05, 10.0, reward), length(thing - target) <= 0.07


def _plate(scene: Scene, slack: float) -> tuple[FloatArray, ...]:
    """(to the target, at it, to the fingers, under them)."""
    thing, target, start = scene.thing, scene.target, scene.start
    short, away = length(thing - target), length(scene.fingers - thing)
    near = tolerance(short, (0, 0.05), scene.way - slack)
    held = tolerance(away, (0, 0.05), length(scene.kept("init_tcp") - start) - slack)
    return short, near, away, held


def _plate_slide(scene: Scene) -> Score:
    short, near, _, held = _plate(scene, 0.0)
    return np.where(short < 0.05, 10.0, 8 * hamacher(held, near)), short <= 0.07


def _plate_drawn(scene: Scene) -> Score:
    short, near, away, held = _plate(scene, 0.05)
    low = (scene.fingers[:, 2] <= 0.03) & (away < 0.07)
    reward = np.where(low, 2.0 + 7.0 * near, 1.5 * held)
    return np.where(short < 0.05, 10.0, reward), short <= 0.07


def _stick_push(scene: Scene) -> Score:
    stick, target = shifted(scene.thing, 0.015), scene.target
    first = scene.kept("stick_init_pos")
    away = length(stick - scene.fingers)
    near = tolerance(length(stick - target), (0, 0.12), length(first - target) - 0.12)
    short = length(scene.second - target)
    moved = tolerance(short, (0, 0.12), length(scene.start - target) - 0.12)
    held = caged(scene, stick, radius=0.04, pads=0.05, plane=0.01, start=first)
    lifted = (away < 0.02) & (scene.opening > 0) & (stick[:, 2] - 0.01 > first[:, 2])
    reward = either(lifted, 2.0 + 5.0 * near + 3.0 * moved, held)
    gripped = scene.touching & (scene.opening > 0) & (scene.thing[:, 2] - 0.01 > first[:, 2])
    return either(lifted & (short <= 0.12), 10.0, reward), gripped & (short <= 0.12)


def _inserted(handle: FloatArray, end: FloatArray) -> BoolArray:
    inside: BoolArray = (end[:, 0] >= handle[:, 0]) & (np.abs(end[:, 1] - handle[:, 1]) <= 0.04)
    return inside & (np.abs(end[:, 2] - handle[:, 2]) <= 0.06)


def _stick_pull(scene: Scene) -> Score:
    stick, handle, target = scene.thing, scene.second, scene.target
    first, scale = scene.kept("stick_init_pos"), np.array([1.0, 1.0, 2.0])
    can, can_first = shifted(handle, 0.05), shifted(scene.start, 0.05)
    away = length(stick - scene.fingers)
    margin = length((first - can_first) * scale)
    in_can = tolerance(length((stick - can) * scale), (0, 0.05), margin)
    near = tolerance(length(stick - target), (0, 0.05), length(first - target))
    moved = tolerance(length(can - target), (0, 0.05), length(scene.start - target))
    held = caged(scene, stick, radius=0.014, pads=0.05, plane=0.01)
    lifted = (away < 0.02) & (scene.opening > 0) & (stick[:, 2] - 0.01 > first[:, 2])
    base = hamacher(either(lifted, 1.0, held), in_can)
    inserted, short = _inserted(handle, scene.site("stick_end")), length(handle - target)
    reward = either(lifted, 1.0 + base + 5.0 * in_can, base)
    pulled = lifted & inserted
    reward = either(pulled, 1.0 + base + 5.0 + 2.0 * near + 1.0 * moved, reward)
    return either(pulled & (short <= 0.12), 10.0, reward), inserted & (short <= 0.12)


_PUCK = ((body("obj"), geom_turn("objGeom")),)
_GEOM = ((geom("objGeom"), geom_turn("objGeom")),)
_MUG = Rules(((body("obj"), geom_turn("mug")),), _mug, reads=("geom_xmat",))
_PLATES = ((geom("puck"), geom_turn("puck")),)
_TURNS, _BOTH = ("geom_xmat",), ("geom_xpos", "geom_xmat")
_DRAWN = Rules(_PLATES, _plate_drawn, reads=_BOTH)

PUSHES = {
    "push": Rules(_PUCK, _push, reads=_TURNS),
    "push-wall": Rules(_GEOM, _push_wall, reads=_BOTH),
    "push-back": Rules(_GEOM, _push_back, reads=_BOTH),
    "sweep": Rules(((body("obj"), body_turn("obj")),), _sweep, reads=("xquat",)),
    "sweep-into": Rules(_PUCK, _sweep_into, reads=_TURNS),
    "soccer": Rules(
        ((body("soccer_ball"), body_matrix_turn("soccer_ball")),), _soccer, reads=("xmat",)
    ),
    "coffee-push": _MUG,
    "coffee-pull": _MUG,
    "plate-slide": Rules(_PLATES, _plate_slide, reads=_BOTH),
    "plate-slide-side": _DRAWN,
    "plate-slide-back": _DRAWN,
    "plate-slide-back-side": _DRAWN,
    "stick-push": Rules(
        ((body("stick"), body_matrix_turn("stick")), (site("insertion", y=0.09), UNTURNED)),
        _stick_push,
        ("stick_init_pos",),
        ("xmat",),
        touches=True,
    ),
    "stick-pull": Rules(
        ((body("stick"), body_matrix_turn("stick")), (site("insertion"), UNTURNED)),
        _stick_pull,
        ("stick_init_pos",),
        ("xmat",),
    ),
}
