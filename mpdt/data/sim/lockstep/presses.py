"""Rewards of what is pressed, turned or slid with a closed hand: buttons, handles, faucets,
windows, the dial and the locks.

Formulas: Farama-Foundation/Metaworld 3.1.1, `envs/`, reward version 2.
"""

from __future__ import annotations

import numpy as np

from mpdt.data.sim.lockstep.scene import (
    UNTURNED,
    Points,
    Rules,
    Scene,
    Score,
    body,
    body_turn,
    shifted,
    site,
    turned,
)
from mpdt.data.sim.lockstep.terms import (
    FloatArray,
    each,
    effort_share,
    hamacher,
    length,
    square,
    tolerance,
)


def _button(
    axis: int,
    won: float,
    *,
    near: float,
    weight: float,
    within: float,
    bonus: float,
    closed: bool = False,
    depth: float | None = None,
) -> Rules:
    """A button that moves along `axis`.

    Args:
        won: success up to this distance from the stop, m.
        near, weight: the fingers at the button, with the gripper open (or `closed`).
        within, bonus: how far it is pressed counts while the fingers are this near.
        depth: how far it can be pressed; default: as measured at the reset.
    """

    def score(scene: Scene) -> Score:
        thing = scene.thing
        away = length(thing - scene.fingers)
        short = np.abs(scene.target[:, axis] - thing[:, axis])
        at = tolerance(away, (0, near), length(thing - scene.kept("init_tcp")))
        way = scene.kept("_obj_to_target_init") if depth is None else depth
        pressed = tolerance(short, (0, 0.005), way)
        hold = 1 - scene.opening if closed else np.maximum(scene.opening, 0.0)
        reward = weight * hamacher(hold, at)
        return np.where(away <= within, reward + bonus * pressed, reward), short <= won

    if depth is not None:  # the machine's button; the others stand in a box
        return Rules(((site("buttonStart"), turned(1.0, 0.0, 0.0, 0.0)),), score)
    by = {"z": 0.193} if axis == 2 else {"y": -0.193}
    things = ((body("button", **by), body_turn("button")),)
    return Rules(things, score, ("_obj_to_target_init",), ("xquat",))


def _button_wall(scene: Scene) -> Score:
    thing = scene.thing
    away = length(thing - scene.fingers)
    short = np.abs(scene.target[:, 1] - thing[:, 1])
    at = tolerance(away, (0, 0.01), length(thing - scene.kept("init_tcp")))
    pressed = tolerance(short, (0, 0.005), scene.kept("_obj_to_target_init"))
    far = 2 * hamacher((1 - scene.opening) / 2.0, at)
    close = 2 + 2 * (1 + scene.opening) + 4 * square(pressed)
    return np.where(away > 0.07, far, close), short <= 0.03


def _handle_press(scene: Scene) -> Score:
    thing, target, start = scene.thing, scene.target, scene.kept("_handle_init_pos")
    short = length((thing - target)[:, 2:])
    margin = np.abs(length((start - target)[:, 2:]) - 0.02)
    pressed = tolerance(short, (0, 0.02), margin)
    reach = np.abs(length(start - scene.kept("init_tcp")) - 0.02)
    at = tolerance(length(thing - scene.fingers), (0, 0.02), reach)
    down = short <= 0.02
    return np.where(down, 1.0, hamacher(at, pressed)) * 10, down


def _faucet(handle: Points, along: float) -> Rules:
    """`along`: x from the handle's observed end to where the fingers are wanted, m."""

    def score(scene: Scene) -> Score:
        thing = shifted(scene.thing, along, 0.0, 0.03) if along else scene.thing
        target, start = scene.target, scene.start
        short = length(thing - target)
        turned_to = tolerance(short, (0, 0.07), np.abs(scene.way - 0.07))
        reach = np.abs(length(start - scene.kept("init_tcp")) - 0.01)
        at = tolerance(length(thing - scene.fingers), (0, 0.01), reach, gaussian=True)
        there = short <= 0.07
        return np.where(there, 10, (2 * at + 3 * turned_to) * 2), there

    return Rules(((handle, body_turn("faucetBase")),), score, reads=("xquat",))


def _window(handle: Points, *, opens: bool) -> Rules:
    def score(scene: Scene) -> Score:
        thing, target, first = scene.thing, scene.target, scene.kept("window_handle_pos_init")
        short = length((thing - target)[:, :1])
        start = scene.start if opens else first
        margin = np.abs(length((start - target)[:, :1]) - 0.05)
        slid = tolerance(short, (0, 0.05), margin)
        reach = np.abs(length(first - scene.kept("init_tcp")) - 0.02)
        away = length(thing - scene.fingers)
        at = tolerance(away, (0, 0.02), reach, gaussian=not opens)
        return 10 * hamacher(at, slid), short <= 0.05

    return Rules(((handle, UNTURNED),), score, ("window_handle_pos_init",))


def _dial_end(scene: Scene) -> FloatArray:
    angle = scene.joint("knob_Joint_1")
    sides = np.stack([each(np.sin, angle), -each(np.cos, angle), np.zeros(scene.rows)], axis=1)
    found: FloatArray = scene.body("dial") + sides * 0.05
    return found


def _dial(scene: Scene) -> Score:
    first = scene.kept("dial_push_position")
    short = length(scene.thing - scene.target)
    margin = np.abs(length(first - scene.target) - 0.07)
    turned_to = tolerance(short, (0, 0.07), margin)
    reach = np.abs(length(first - scene.kept("init_tcp")) - 0.005)
    away = length(shifted(scene.thing, 0.05, 0.02, 0.09) - scene.fingers)
    at = tolerance(away, (0, 0.005), reach, gaussian=True)
    held = hamacher(effort_share(scene.effort, 1.0), at)
    return hamacher(held, turned_to) * 10, short <= 0.07


def _door_lock(scene: Scene) -> Score:
    thing, pad = scene.thing, scene.body("leftpad")
    away = length((thing - pad) * np.array([0.25, 1.0, 0.5]))
    short = np.abs(scene.target[:, 2] - thing[:, 2])
    # The pad at the reset is meant; what Meta-World keeps of it is a view that moves along.
    at = tolerance(away, (0, 0.01), away)
    turned_to = tolerance(short, (0, 0.005), 0.1)
    reward = 2 * hamacher(np.maximum(scene.opening, 0.0), at) + 8 * turned_to
    return reward, short <= 0.02


def _door_unlock(scene: Scene) -> Score:
    scale = np.array([0.25, 1.0, 0.5])
    away = length((shifted(scene.hand, 0.0, 0.055, 0.07) - scene.thing) * scale)
    first = shifted(scene.kept("init_tcp"), 0.0, 0.055, 0.07)
    # The lock at the reset is meant; what Meta-World keeps of it is a view that moves along.
    margin = length((first - scene.body("lock_link")) * scale)
    at = tolerance(away, (0, 0.02), margin)
    short = np.abs(scene.target[:, 0] - scene.thing[:, 0])
    return 2 * at + 8 * tolerance(short, (0, 0.005), 0.1), short <= 0.02


_PRESSED = Rules(((site("handleStart"), UNTURNED),), _handle_press, ("_handle_init_pos",))

PRESSES = {
    "button-press-topdown": _button(
        2, 0.024, near=0.01, weight=5, within=0.03, bonus=5, closed=True
    ),
    "button-press-topdown-wall": _button(2, 0.024, near=0.01, weight=5, within=0.03, bonus=5),
    "button-press": _button(1, 0.02, near=0.05, weight=2, within=0.05, bonus=8),
    "button-press-wall": Rules(
        ((body("button", y=-0.193), body_turn("button")),),
        _button_wall,
        ("_obj_to_target_init",),
        ("xquat",),
    ),
    "coffee-button": _button(1, 0.02, near=0.05, weight=2, within=0.05, bonus=8, depth=0.03),
    "handle-press": _PRESSED,
    "handle-press-side": _PRESSED,
    "faucet-open": _faucet(site("handleStartOpen", z=-0.01), -0.04),
    "faucet-close": _faucet(site("handleStartClose", z=-0.01), 0.0),
    "window-open": _window(site("handleOpenStart"), opens=True),
    "window-close": _window(site("handleCloseStart"), opens=False),
    "dial-turn": Rules(
        ((_dial_end, body_turn("dial")),), _dial, ("dial_push_position",), ("xquat",)
    ),
    "door-lock": Rules(
        ((site("lockStartLock"), body_turn("door_link")),), _door_lock, reads=("xquat",)
    ),
    "door-unlock": Rules(
        ((site("lockStartUnlock"), body_turn("door_link")),), _door_unlock, reads=("xquat",)
    ),
}
