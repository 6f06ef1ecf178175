"""Rewards of what is gripped and must not tilt: the nut, the hammer, the lid.

Formulas: Farama-Foundation/Metaworld 3.1.1, `envs/`, reward version 2.
"""

from __future__ import annotations

import numpy as np

from mpdt.data.sim.lockstep.grasp import caged
from mpdt.data.sim.lockstep.hinges import above_funnel, half_effort
from mpdt.data.sim.lockstep.scene import Rules, Scene, Score, body, body_turn, shifted, site
from mpdt.data.sim.lockstep.terms import (
    FloatArray,
    either,
    hamacher,
    length,
    level_log,
    tolerance,
    values,
)

_HALF_TURNED = (0.707, 0.0, 0.0, 0.707)


def _upright(scene: Scene, wanted: tuple[float, ...], slack: float) -> FloatArray:
    """1 where the first object is turned as wanted."""
    error = length(scene.seen[:, 7:11] - np.array(wanted))
    return np.maximum(1.0 - error / slack, 0.0)


def _along(scene: Scene, threshold: float) -> FloatArray:
    """The first object's place, its x the hand's where they are near: it may be held anywhere."""
    held = scene.thing.copy()
    near = np.abs(held[:, 0] - scene.hand[:, 0]) < threshold
    held[near, 0] = scene.hand[near, 0]
    return held


def _assembly(scene: Scene) -> Score:
    centre, error = scene.site("RoundNut"), scene.target - scene.site("RoundNut")
    radius = length(error[:, :2])
    won = (radius < 0.02) & (error[:, 2] > 0.0)
    # The threshold is twice as wide for who has won, whose reward is 10 whatever it was.
    height = level_log(radius, 0.01, 0.02, 0.2)
    error[:, 2] = height - centre[:, 2]
    lifted = (centre[:, 2] > 0.02) | (radius < 0.01)
    near = tolerance(length(error * np.array([1.0, 1.0, 3.0])), (0, 0.02), 0.4)
    place = 0.1 * lifted + 0.9 * near
    held = caged(scene, _along(scene, 0.01), radius=0.015, pads=0.02, plane=0.01, density="medium")
    reward = (2.0 * held + 6.0 * place) * _upright(scene, _HALF_TURNED, 0.4)
    return either(won, 10.0, reward), won


def _disassemble(scene: Scene) -> Score:
    centre = scene.site("RoundNut")
    near = tolerance(length(shifted(scene.target, z=0.1) - centre), (0, 0.02), 0.2)
    place = 0.1 * (centre[:, 2] > 0.02) + 0.9 * near
    held = caged(scene, _along(scene, 0.01), radius=0.015, pads=0.02, plane=0.01)
    reward = (2.0 * held + 6.0 * place) * _upright(scene, _HALF_TURNED, 0.4)
    won = scene.thing[:, 2] > scene.target[:, 2]
    return either(won, 10.0, reward), won


def _hammer(scene: Scene) -> Score:
    head = shifted(scene.thing, 0.16, 0.06)
    near = tolerance(length(scene.target - head), (0, 0.02), 0.2)
    place = 0.1 * (head[:, 2] > 0.02) + 0.9 * near
    held = caged(scene, _along(scene, 0.14 / 2.0), radius=0.015, pads=0.02, plane=0.01)
    reward = (2.0 * held + 6.0 * place) * _upright(scene, (1.0, 0.0, 0.0, 0.0), 0.4)
    won = scene.joint("NailSlideJoint") > 0.09
    return either(won & (values(reward) > 5.0), 10.0, reward), won


def _box_close(scene: Scene) -> Score:
    lid, target = shifted(scene.thing, z=0.02), scene.target
    above = above_funnel(scene, lid, 0.02)
    ready = hamacher(above, tolerance(length(scene.hand - lid), (0, 0.02), 0.5))
    error = (target - lid) * np.array([1.0, 1.0, 3.0])
    lifted = 0.2 * (lid[:, 2] > 0.04) + 0.8 * tolerance(length(error), (0, 0.05), 0.25)
    reward = 2.0 * hamacher(half_effort(scene), ready) + 8.0 * lifted
    won = length(scene.thing - target) < 0.08
    return np.where(won, 10.0, reward) * _upright(scene, _HALF_TURNED, 0.2), won


_NUT = ((site("RoundNut-8"), body_turn("RoundNut")),)
_TURNS = ("xquat",)

TOOLS = {
    "assembly": Rules(_NUT, _assembly, reads=_TURNS),
    "disassemble": Rules(_NUT, _disassemble, reads=_TURNS),
    "hammer": Rules(
        ((body("hammer"), body_turn("hammer")), (body("nail_link"), body_turn("nail_link"))),
        _hammer,
        reads=_TURNS,
    ),
    "box-close": Rules(((body("top_link"), body_turn("top_link")),), _box_close, reads=_TURNS),
}
