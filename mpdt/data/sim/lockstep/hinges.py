"""Rewards of what hangs on hinges and rails: doors, drawers, the lever, handles to pull; and of
the hand alone, which has to reach a place.

Formulas: Farama-Foundation/Metaworld 3.1.1, `envs/`, reward version 2.
"""

from __future__ import annotations

import numpy as np

from mpdt.data.sim.lockstep.grasp import caged
from mpdt.data.sim.lockstep.scene import (
    UNTURNED,
    Rules,
    Scene,
    Score,
    body,
    body_turn,
    geom,
    geom_turn,
    shifted,
    site,
)
from mpdt.data.sim.lockstep.terms import (
    FloatArray,
    effort_share,
    either,
    hamacher,
    length,
    level_log,
    tolerance,
)


def above_funnel(scene: Scene, over: FloatArray, threshold: float) -> FloatArray:
    """1 while the hand is above a funnel around `over` (B, 3), which narrows downwards: (B,)."""
    height = scene.hand[:, 2]
    floor = level_log(length((scene.hand - over)[:, :2]), threshold, 0.04, 0.4)
    below = height < floor
    worth = np.ones(len(floor))
    short, margin = (floor - height)[below], (floor / 2.0)[below]
    worth[below] = tolerance(short, (0.0, 0.01), margin)
    return worth


def half_effort(scene: Scene) -> FloatArray:
    """The effort -1 to 1 as 0 to 1, (B,), which Meta-World computes in float32."""
    return ((scene.effort.clip(-1, 1) + np.float32(1.0)) / np.float32(2.0)).astype(np.float64)


def _door_open(scene: Scene) -> Score:
    door = shifted(scene.thing, -0.05)
    above = above_funnel(scene, door, 0.12)
    at = tolerance(length(scene.hand - door - np.array([0.05, 0.03, -0.01])), (0, 0.06), 0.5)
    ready = hamacher(above, at)
    angle = scene.joint("doorjoint")
    still = np.pi / 2.0 + np.pi / 6 - -angle
    opened = 0.2 * (angle < -np.pi / 90.0) + 0.8 * tolerance(still, (0, 0.5), np.pi / 3.0)
    reward = 2.0 * hamacher(ready, half_effort(scene)) + 8.0 * opened
    won = np.abs(scene.thing[:, 0] - scene.target[:, 0]) <= 0.08
    return np.where(won, 10.0, reward), won


def _door_close(scene: Scene) -> Score:
    short = length(scene.thing - scene.target)
    margin = scene.way
    closed = tolerance(short, (0, 0.05), margin, gaussian=True)
    reach = length(scene.kept("hand_init_pos") - scene.thing) + 0.1
    away = length(scene.fingers - scene.target)
    at = tolerance(away, (0, 0.25 * 0.05), reach, gaussian=True)
    return np.where(short < 0.05, 10, 3 * at + 6 * closed), short <= 0.08


def _drawer_open(scene: Scene) -> Score:
    scale = np.array([3.0, 3.0, 1.0])
    short = length(scene.thing - scene.target)
    opened = tolerance(short, (0, 0.02), 0.2)
    first = (shifted(scene.target, 0.0, 0.2) - scene.kept("init_tcp")) * scale
    away = length((scene.thing - scene.hand) * scale)
    at = tolerance(away, (0, 0.01), length(first))
    return (at + opened) * 5.0, short <= 0.03


def _drawer_close(scene: Scene) -> Score:
    short = length(scene.thing - scene.target)
    margin = np.abs(scene.way - 0.05)
    closed = tolerance(short, (0, 0.05), margin)
    reach = np.abs(length(scene.start - scene.kept("init_tcp")) - 0.005)
    at = tolerance(length(scene.thing - scene.fingers), (0, 0.005), reach, gaussian=True)
    held = hamacher(effort_share(scene.effort, 1.0), at)
    won = short <= 0.05 + 0.015
    return either(won, 1.0, hamacher(held, closed)) * 10, won


def _lever(scene: Scene) -> Score:
    scale, first = np.array([4.0, 1.0, 4.0]), scene.kept("_lever_pos_init")
    away = length((shifted(scene.hand, 0.0, 0.055, 0.07) - scene.thing) * scale)
    reach = length((shifted(scene.kept("init_tcp"), 0.0, 0.055, 0.07) - first) * scale)
    ready = tolerance(away, (0, 0.02), reach)
    up = tolerance(length(scene.thing - scene.target), (0, 0.04), length(first - scene.target))
    off = np.abs(-scene.joint("LeverAxis") - np.pi / 2.0)
    return 10.0 * hamacher(ready, up), off <= np.pi / 24


def _handle_pull(scene: Scene) -> Score:
    thing, target, start = scene.thing, scene.target, scene.start
    short = np.abs(target[:, 2] - thing[:, 2])
    pulled = tolerance(short, (0, 0.05), np.abs(target[:, 2] - start[:, 2]))
    held = caged(scene, thing, radius=0.022, pads=0.05, plane=0.01)
    reward = hamacher(held, pulled)
    lifted = (length(thing - scene.fingers) < 0.035) & (scene.opening > 0)
    lifted &= thing[:, 1] - 0.01 > start[:, 2]  # y against z, as published
    reward = either(lifted, reward + (1.0 + 5.0 * pulled), reward)
    return either(short < 0.05, 10.0, reward), short <= 0.05


def _handle_pull_side(scene: Scene) -> Score:
    thing, target, start = scene.thing, scene.target, scene.start
    short = length(thing - target)
    pulled = tolerance(short, (0, 0.05), scene.way)
    held = caged(scene, thing, radius=0.032, pads=0.06, plane=0.01)
    reward = hamacher(held, pulled)
    lifted = (length(thing - scene.fingers) < 0.035) & (scene.opening > 0)
    lifted &= thing[:, 2] - 0.01 > start[:, 2]
    reward = either(lifted, reward + (1.0 + 5.0 * pulled), reward)
    return either(short < 0.05, 10.0, reward), short <= 0.08


def _reach(scene: Scene) -> Score:
    away = length(scene.fingers - scene.target)
    at = tolerance(away, (0, 0.05), length(scene.kept("hand_init_pos") - scene.target))
    return 10 * at, away <= 0.05


_DOOR = ((geom("handle"), geom_turn("handle")),)
_DOOR_READS = ("geom_xpos", "geom_xmat")
_REACHED = Rules(((body("obj"), geom_turn("objGeom")),), _reach, ("hand_init_pos",), ("geom_xmat",))

HINGES = {
    "door-open": Rules(_DOOR, _door_open, reads=_DOOR_READS),
    "door-close": Rules(_DOOR, _door_close, ("hand_init_pos",), _DOOR_READS),
    "drawer-open": Rules(
        ((body("drawer_link", y=-0.16), body_turn("drawer_link")),), _drawer_open, reads=("xquat",)
    ),
    "drawer-close": Rules(((body("drawer_link", y=-0.16, z=0.05), UNTURNED),), _drawer_close),
    "lever-pull": Rules(
        ((site("leverStart"), geom_turn("objGeom")),), _lever, ("_lever_pos_init",), ("geom_xmat",)
    ),
    "handle-pull": Rules(((site("handleRight"), UNTURNED),), _handle_pull),
    "handle-pull-side": Rules(((site("handleCenter"), UNTURNED),), _handle_pull_side),
    "reach": _REACHED,
    "reach-wall": _REACHED,
}
