"""Meta-World's scripts that press, turn, slide or push with the hand as it is, row by row the
same answers: buttons, doors, drawers, faucets, handles, plates, windows.

Rules: Farama-Foundation/Metaworld 3.1.1, `policies/`. Lengths in m, gains in 1 / cm.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from types import MappingProxyType

import numpy as np

from mpdt.data.sim.lockstep.scene import shifted
from mpdt.data.sim.lockstep.sight import (
    Move,
    Script,
    Sight,
    approach,
    at,
    choose,
    far,
    far_in_plane,
    off,
)
from mpdt.data.sim.lockstep.terms import BoolArray, FloatArray, length

Offset = tuple[float, float, float]


def _beside(
    see: Sight,
    offset: Offset,
    then: Offset,
    effort: float,
    *,
    aside: float,
    over: float,
    apart: float,
    gain: float = 25.0,
) -> Move:
    """Over a place beside the object, down to it, then on from there."""
    place = shifted(see.first, *offset)
    on = shifted(place, *then)
    return Move(approach(see, place, on, aside=aside, over=over, apart=apart), gain, effort)


def _stamp(
    see: Sight, offset: Offset, effort: float, *, aside: float, over: float, down: float
) -> Move:
    """Over a place beside the object, then down."""
    place = shifted(see.first, *offset)
    aim = choose(shifted(place, z=down), (far(see.hand, place, aside), shifted(place, z=over)))
    return Move(aim, 25.0, effort)


def _close_to(a: FloatArray, b: FloatArray) -> BoolArray:
    near: BoolArray = np.abs(a - b) <= 0.02 + 1e-5 * np.abs(b)  # numpy's `isclose`, 0.02 absolute
    return near


def _button(see: Sight) -> Move:
    button = shifted(see.first, z=-0.07)
    before = at(button[:, 0], see.hand[:, 1] - 0.1, button[:, 2])
    there = _close_to(see.hand[:, 0], button[:, 0]) & _close_to(see.hand[:, 2], button[:, 2])
    return Move(choose(shifted(button, y=0.02), (~there, before)), 25.0, 0.0)


def _button_wall(see: Sight) -> Move:
    button = shifted(see.first, z=0.04)
    x, y, _ = button.T
    beside, behind = off(see.hand, button, 0.02, 0), y - see.hand[:, 1] > 0.09
    high = off(see.hand, button, 0.02)
    aim = choose(
        shifted(button, y=-0.02),
        (beside, at(x, see.hand[:, 1], 0.3)),
        (behind, at(x, y, 0.3)),
        (high, shifted(button, y=-0.05)),
    )
    return Move(aim, 15.0, np.where(beside | behind | high, 1.0, -1.0))


def _coffee_button(see: Sight) -> Move:
    button = shifted(see.first, z=-0.07)
    level = at(button[:, 0], see.hand[:, 1], button[:, 2])
    away = far_in_plane(see.hand, button, 0.02)
    return Move(choose(shifted(button, y=0.2), (away, level)), 10.0, -1.0)


def _dial(see: Sight) -> Move:
    dial = shifted(see.first, 0.05, 0.02, 0.09)
    aim = choose(
        shifted(dial, -0.05, 0.005),
        (far(see.hand, dial, 0.02), at(dial[:, 0], dial[:, 1], 0.2)),
        (off(see.hand, dial, 0.02), dial),
    )
    return Move(aim, 10.0, 1.0)


def _door_close(see: Sight) -> Move:
    hand, door = see.hand, shifted(see.first, 0.05, 0.12, 0.1)
    inside = hand[:, 0] > door[:, 0]
    low = hand[:, 2] < door[:, 2] + 0.2
    aim = choose(
        see.goal,
        (inside & low, at(hand[:, 0], hand[:, 1], door[:, 2] + 0.25)),
        (inside, at(door[:, 0] - 0.02, door[:, 1], hand[:, 2])),
        (off(hand, door, 0.04), shifted(door, -0.02)),
    )
    return Move(aim, 25.0, 1.0)


def _door_open(see: Sight) -> Move:
    door = shifted(see.first, -0.05)
    aim = choose(
        door,
        (far(see.hand, door, 0.12), shifted(door, 0.06, 0.02, 0.2)),
        (off(see.hand, door, 0.04), shifted(door, 0.06, 0.02)),
    )
    return Move(aim, 25.0, 1.0)


def _door_lock(see: Sight) -> Move:
    lock = shifted(see.first, -0.02, -0.02)
    away = far(see.hand, lock, 0.02)
    aim = choose(
        shifted(lock, -0.1, 0.0, -0.1),
        (away & (see.hand[:, 2] < 0.25), shifted(see.hand, 0.0, -0.1, 0.1)),
        (away, shifted(lock, z=0.3)),
        (off(see.hand, lock, 0.02), lock),
    )
    return Move(aim, 25.0, -1.0)


def _door_unlock(see: Sight) -> Move:
    lock = shifted(see.first, -0.04, -0.02, -0.03)
    away = far(see.hand, lock, 0.02)
    aim = choose(
        shifted(lock, 0.1, 0.0, 0.01),
        (away & (see.hand[:, 2] > 0.15), shifted(see.hand, 0.0, -0.1, -0.1)),
        (away, lock),
    )
    return Move(aim, 25.0, 1.0)


def _drawer_close(see: Sight) -> Move:
    hand, drawer = see.hand, shifted(see.first, z=-0.02)
    inside, low = hand[:, 1] > drawer[:, 1], hand[:, 2] < drawer[:, 2] + 0.23
    aim = choose(
        drawer,
        (inside & low, at(hand[:, 0], hand[:, 1], drawer[:, 2] + 0.5)),
        (inside, shifted(drawer, 0.0, -0.075, 0.23)),
        (off(hand, drawer, 0.04), shifted(drawer, 0.0, -0.075)),
    )
    return Move(aim, 25.0, 1.0)


def _drawer_open(see: Sight) -> Move:
    drawer = shifted(see.first, z=-0.02)
    on = shifted(drawer, 0.0, -0.06)
    away = far(see.hand, drawer, 0.06) | off(see.hand, drawer, 0.04)
    aim = approach(see, drawer, on, aside=0.06, over=0.3, apart=0.04)
    return Move(aim, np.where(away, 4.0, 50.0), -1.0)


def _handle_pull(see: Sight) -> Move:
    handle = shifted(see.first, 0.0, -0.04)
    z = handle[:, 2]
    aim = choose(
        shifted(handle, z=0.1),
        (far(see.hand, handle, 0.02), handle),
        (off(see.hand, handle, 0.02), at(z, z, z)),  # as published: the height for all three
    )
    return Move(aim, 25.0, 1.0)


def _plate(see: Sight) -> Move:
    plate = shifted(see.first, 0.0, -0.055, 0.03)
    into = at(see.goal[:, 0], 0.9, plate[:, 2])
    return Move(approach(see, plate, into, aside=0.03, over=0.1, apart=0.04), 10.0, -1.0)


def _plate_side(see: Sight) -> Move:
    hand, plate = see.hand, shifted(see.first, 0.07, 0.0, -0.005)
    left = at(hand[:, 0] - 0.1, 0.6, hand[:, 2])
    then = choose(shifted(plate, -0.1), (hand[:, 0] > -0.2, left))
    return Move(approach(see, plate, then, aside=0.04, over=0.1, apart=0.04), 25.0, 1.0)


def _plate_back(see: Sight) -> Move:
    hand, plate = see.hand, shifted(see.first, 0.0, -0.065, 0.025)
    then = choose(
        at(hand[:, 0] - 0.1, 0.55, hand[:, 2]),
        (hand[:, 1] > 0.7, shifted(hand, 0.0, -0.1)),
        (hand[:, 1] > 0.6, at(0.15, 0.55, hand[:, 2])),
    )
    return Move(approach(see, plate, then, aside=0.01, over=0.1, apart=0.04), 10.0, -1.0)


def _plate_back_side(see: Sight) -> Move:
    hand, plate = see.hand, shifted(see.first, 0.023, 0.0, 0.025)
    then = at(hand[:, 0] + 0.1, 0.6, hand[:, 2])
    return Move(approach(see, plate, then, aside=0.01, over=0.07, apart=0.04), 10.0, 1.0)


def _reach(see: Sight) -> Move:
    return Move(see.goal, 5.0, 0.0)


def _reach_wall(see: Sight) -> Move:
    x, y, z = see.hand.T
    low = (x >= -0.1) & (x <= 0.3) & (y >= 0.6) & (y <= 0.8) & (z < 0.25)
    return Move(choose(see.goal, (low, shifted(see.goal, z=1.0))), 5.0, 0.0)


def _soccer(see: Sight) -> Move:
    ball = shifted(see.first, z=0.03)
    beside = ball[:, 0] - see.goal[:, 0]
    push = choose(
        shifted(ball, y=-0.03),
        (beside < -0.05, shifted(ball, -0.03)),
        (beside > 0.05, shifted(ball, 0.03)),
    )
    push[:, 2] = np.where(length((see.hand - ball)[:, :2]) < 0.02, 0.1, 0.03)
    return Move(choose(ball, (length(see.hand - push) > 0.01, push)), 25.0, 1.0)


PRESSING: Mapping[str, Script] = MappingProxyType(
    {
        "button-press-topdown": partial(
            _stamp, offset=(0, 0, 0), effort=1.0, aside=0.04, over=0.1, down=0.0
        ),
        "button-press-topdown-wall": partial(
            _stamp, offset=(0, -0.06, 0), effort=-1.0, aside=0.04, over=0.1, down=0.0
        ),
        "button-press": _button,
        "button-press-wall": _button_wall,
        "coffee-button": _coffee_button,
        "dial-turn": _dial,
        "door-close": _door_close,
        "door-open": _door_open,
        "door-lock": _door_lock,
        "door-unlock": _door_unlock,
        "drawer-close": _drawer_close,
        "drawer-open": _drawer_open,
        "faucet-open": partial(
            _beside, offset=(-0.04, 0, 0.03), then=(0.1, 0.05, 0), effort=1.0,
            aside=0.04, over=0.1, apart=0.04,
        ),
        "faucet-close": partial(
            _beside, offset=(0.04, 0, 0.03), then=(-0.1, 0.05, 0), effort=1.0,
            aside=0.04, over=0.1, apart=0.04,
        ),
        "handle-press": partial(
            _stamp, offset=(0, -0.02, 0), effort=-1.0, aside=0.02, over=0.2, down=-0.5
        ),
        "handle-press-side": partial(
            _stamp, offset=(0, 0, 0), effort=1.0, aside=0.02, over=0.2, down=-0.5
        ),
        "handle-pull": _handle_pull,
        "lever-pull": partial(
            _beside, offset=(0, -0.055, 0), then=(0, 0.08, 0.02), effort=1.0,
            aside=0.02, over=-0.1, apart=0.02,
        ),
        "plate-slide": _plate,
        "plate-slide-side": _plate_side,
        "plate-slide-back": _plate_back,
        "plate-slide-back-side": _plate_back_side,
        "reach": _reach,
        "reach-wall": _reach_wall,
        "soccer": _soccer,
        "window-open": partial(
            _beside, offset=(-0.03, -0.03, -0.08), then=(0.1, 0, 0), effort=1.0,
            aside=0.04, over=0.3, apart=0.02,
        ),
        "window-close": partial(
            _beside, offset=(0.03, -0.03, -0.08), then=(-0.1, 0, 0), effort=1.0,
            aside=0.04, over=0.25, apart=0.02,
        ),
    }
)  # fmt: skip
