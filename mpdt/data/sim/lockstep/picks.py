"""Rewards of what is gripped, lifted and brought somewhere: pucks, pegs, balls, blocks.

Formulas: Farama-Foundation/Metaworld 3.1.1, `envs/`, reward version 2.
"""

from __future__ import annotations

import numpy as np

from mpdt.data.sim.lockstep.grasp import caged, caged_between
from mpdt.data.sim.lockstep.scene import (
    Rules,
    Scene,
    Score,
    body,
    body_turn,
    geom,
    geom_turn,
    site,
    site_turn,
)
from mpdt.data.sim.lockstep.terms import (
    BoolArray,
    FloatArray,
    add_wide,
    either,
    hamacher,
    length,
    level_log,
    tolerance,
    values,
)


def _lifted(scene: Scene, away: FloatArray, near: float, height: float) -> BoolArray:
    """The fingers are at the thing, which has left the table by `height`, m."""
    lifted: BoolArray = (away < near) & (scene.opening > 0)
    return lifted & (scene.thing[:, 2] - height > scene.start[:, 2])


def _above(height: FloatArray, floor: FloatArray, margin: float) -> FloatArray:
    """1 where `height` is over the floor."""
    short = np.maximum(floor - height, 0.0)
    return np.where(height >= floor, 1.0, tolerance(short, (0.0, 0.01), margin))


def _pick_place(scene: Scene) -> Score:
    short, away = length(scene.thing - scene.target), length(scene.thing - scene.fingers)
    near = tolerance(short, (0, 0.05), scene.way)
    reward = hamacher(caged_between(scene, scene.thing), near)
    lifted = _lifted(scene, away, 0.02, 0.01)
    reward = either(lifted, reward + (1.0 + 5.0 * near), reward)
    return either(short < 0.05, 10.0, reward), short <= 0.07


def _pick_place_wall(scene: Scene) -> Score:
    thing, target, start = scene.thing, scene.target, scene.start
    scale, middle = np.array([1.0, 1.0, 3.0]), np.tile([0.0, 0.77, 0.25], (scene.rows, 1))
    middle[:, 0] = target[:, 0]
    short, away = length(thing - target), length(thing - scene.fingers)
    margin = length((start - middle) * scale)
    half = tolerance(length((thing - middle) * scale), (0, 0.05), margin)
    near = tolerance(short, (0, 0.05), scene.way)
    held = caged(scene, thing, radius=0.015, pads=0.05, plane=0.005, density="")
    base = hamacher(held, half)
    lifted = _lifted(scene, away, 0.02, 0.015)
    reward = either(lifted, base + 1.0 + 4.0 * half, base)
    reward = either(lifted & (thing[:, 1] > 0.75), base + 1.0 + 4.0 + 3.0 * near, reward)
    return either(short < 0.05, 10.0, reward), short <= 0.07


def _pick_out_of_hole(scene: Scene) -> Score:
    thing, target, fingers = scene.thing, scene.target, scene.fingers
    short, away = length(thing - target), length(thing - fingers)
    floor = level_log(length((fingers - scene.start)[:, :2]), 0.03, 0.015, 0.15)
    above = _above(fingers[:, 2], floor, 0.02)
    held = caged(scene, thing, radius=0.015, pads=0.02, plane=0.03, effort=0.1)
    near = tolerance(short, (0, 0.02), length(scene.start - target))
    reward = hamacher(held, near)
    lifted = (away < 0.04) & (thing[:, 2] - 0.02 > scene.start[:, 2]) & ~(scene.opening < 0.33)
    reward = either(lifted, reward + (1.0 + 5.0 * hamacher(near, above)), reward)
    return either(short < 0.05, 10.0, reward), short <= 0.07


def _in_prism(
    points: FloatArray, zero: FloatArray, one: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """The published `rect_prism_tolerance`, and whether each point is inside: (B,) both."""
    low, high = np.minimum(zero, one), np.maximum(zero, one)
    inside: BoolArray = np.all((low <= points) & (points <= high), axis=1)
    worth = np.ones(len(points))
    x, y, z = ((points - zero)[inside] / (one - zero)[inside]).T
    worth[inside] = x * y * z
    return worth, inside


def _peg_insert(scene: Scene) -> Score:
    head, target, scale = scene.site("pegHead"), scene.target, np.array([1.0, 2.0, 2.0])
    short = length((head - target) * scale)
    margin = length((scene.kept("peg_head_pos_init") - target) * scale)
    near = tolerance(short, (0, 0.07), margin)
    (first, in_first), (second, in_second) = (
        _in_prism(
            head,
            scene.site(f"bottom_right_corner_collision_box_{number}"),
            scene.site(f"top_left_corner_collision_box_{number}"),
        )
        for number in (1, 2)
    )
    near = hamacher(near, hamacher(second, first))
    held = caged(scene, scene.thing, radius=0.0075, pads=0.03, plane=0.005)
    lifted = _lifted(scene, length(scene.thing - scene.fingers), 0.08, 0.01)
    held = either(lifted, 1.0, held)
    # Inside a prism the term is a numpy number, which widens a float32.
    reward = either(in_first | in_second, hamacher(values(held), near), hamacher(held, near))
    reward = either(lifted, reward + (1.0 + 5 * near), reward)
    won = short <= 0.07
    return either(won, 10.0, reward), won


def _peg_unplug(scene: Scene) -> Score:
    thing, target, start = scene.thing, scene.target, scene.start
    short, away = length(thing - target), length(thing - scene.fingers)
    held = caged(scene, thing, radius=0.025, pads=0.05, plane=0.005, effort=0.8)
    near = tolerance(short, (0, 0.05), scene.way)
    out = (scene.opening > 0.5) & (thing[:, 0] - start[:, 0] > 0.015) & (away < 0.035)
    reward = either(out, 1 + 2 * held + 5 * near, 2 * held)
    return either(short <= 0.05, 10.0, reward), short <= 0.07


def _hoop(scene: Scene) -> FloatArray:
    return scene.site("goal")  # a view in Meta-World too: it moves along


def _basketball(scene: Scene) -> Score:
    thing, scale, target = scene.thing, np.array([1.0, 1.0, 2.0]), _hoop(scene).copy()
    target[:, 2] = 0.3
    short = length((thing - target) * scale)
    near = tolerance(short, (0, 0.08), length((scene.start - target) * scale))
    held = caged(scene, thing, radius=0.025, pads=0.06, plane=0.005)
    lifted = _lifted(scene, length(thing - scene.fingers), 0.035, 0.01)
    reward = hamacher(either(lifted, 1.0, held), near)
    reward = either(lifted, reward + (1.0 + 5.0 * near), reward)
    return either(short < 0.08, 10.0, reward), short <= 0.08


def _bin(scene: Scene) -> FloatArray:
    return scene.body("bin_goal")


def _bin_picking(scene: Scene) -> Score:
    hand, thing, target = scene.hand, scene.thing, _bin(scene)
    short = length(thing - target)
    near = tolerance(short, (0, 0.05), scene.once("short", lambda: short))
    floors = [level_log(length((hand - over)[:, :2]), 0.03, 0.02, 0.2)
              for over in (scene.start, target)]  # fmt: skip
    above = _above(hand[:, 2], np.minimum(*floors), 0.05)
    held = caged(scene, thing, radius=0.015, pads=0.05, plane=0.01, effort=0.7)
    reward = hamacher(held, near)
    lifted = (length(thing - hand) < 0.04) & (thing[:, 2] - 0.02 > scene.start[:, 2])
    lifted &= ~(scene.opening < 0.43)
    reward = either(lifted, reward + (1.0 + 5.0 * hamacher(above, near)), reward)
    return either(short < 0.05, 10.0, reward), short <= 0.05


def _shelf(scene: Scene) -> Score:
    thing, target = scene.thing, scene.target
    x, y, z = thing.T
    short, away = length(thing - target), length(thing - scene.fingers)
    near = tolerance(short, (0, 0.05), length(scene.start - target))
    held = caged(scene, thing, radius=0.02, pads=0.05, plane=0.01, density="")
    reward = hamacher(held, near)
    depth = 3 * 0.05
    edge = target[:, 1] - depth
    under = (z > 0.0) & (z < 0.24) & (target[:, 0] - 0.15 < x) & (x < target[:, 0] + 0.15)
    before = under & (edge < y) & (y < target[:, 1])
    lost = np.zeros(scene.rows)
    lost[before] = hamacher(((y - edge) / depth)[before], ((0.24 - z) / 0.24)[before])
    near = np.where(before, (near - lost).clip(0.0, 1.0), near)
    near = np.where(under & (y > target[:, 1]), 0.0, near)
    lifted = _lifted(scene, away, 0.025, 0.01)
    # Before the shelf the term is a numpy number, which widens a float32.
    reward = either(lifted, add_wide(reward, 1.0 + 5.0 * near, before), reward)
    return either(short < 0.05, 10.0, reward), short <= 0.07


def _hand_insert(scene: Scene) -> Score:
    short, away = length(scene.thing - scene.target), length(scene.thing - scene.fingers)
    near = tolerance(short, (0, 0.05), scene.way)
    reward = hamacher(caged(scene, scene.thing, radius=0.015, pads=0.05, plane=0.005), near)
    at = (away < 0.02) & (scene.opening > 0)
    reward = either(at, reward + (1.0 + 7.0 * near), reward)
    return either(short < 0.05, 10.0, reward), short <= 0.05


_OBJ = ((body("obj"), body_turn("obj")),)
_TURNS = ("xquat",)

PICKS = {
    "pick-place": Rules(((body("obj"), geom_turn("objGeom")),), _pick_place, reads=("geom_xmat",)),
    "pick-place-wall": Rules(
        ((geom("objGeom"), geom_turn("objGeom")),),
        _pick_place_wall,
        reads=("geom_xpos", "geom_xmat"),
    ),
    "pick-out-of-hole": Rules(_OBJ, _pick_out_of_hole, reads=_TURNS),
    "peg-insert-side": Rules(
        ((site("pegGrasp"), site_turn("pegGrasp")),),
        _peg_insert,
        ("peg_head_pos_init",),
        ("site_xmat",),
    ),
    "peg-unplug-side": Rules(((site("pegEnd"), body_turn("plug1")),), _peg_unplug, reads=_TURNS),
    "basketball": Rules(
        ((body("bsktball"), body_turn("bsktball")),), _basketball, reads=_TURNS, goal=_hoop
    ),
    "bin-picking": Rules(_OBJ, _bin_picking, reads=_TURNS, goal=_bin),
    "shelf-place": Rules(((body("obj"), geom_turn("objGeom")),), _shelf, reads=("geom_xmat",)),
    "hand-insert": Rules(_OBJ, _hand_insert, reads=_TURNS),
}
