"""Meta-World's scripts that grip something and take it along, row by row the same answers.

Rules: Farama-Foundation/Metaworld 3.1.1, `policies/`. Lengths in m, gains in 1 / cm.
"""

from __future__ import annotations

from collections.abc import Mapping
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
    grip,
    off,
)
from mpdt.data.sim.lockstep.terms import FloatArray, length


def _assembly(see: Sight) -> Move:
    hand, wrench = see.hand, shifted(see.first, -0.02)
    peg = shifted(see.goal, 0.12, 0.0, 0.14)
    aim = choose(
        peg,
        (far(hand, wrench, 0.02), shifted(wrench, z=0.1)),
        (~far(hand, peg, 0.02), shifted(peg, z=-0.2)),
        (off(hand, wrench, 0.05), shifted(wrench, z=0.03)),
        (off(hand, peg, 0.04), at(hand[:, 0], hand[:, 1], peg[:, 2])),
    )
    return Move(aim, 10.0, grip(see, wrench, 0.0, 0.6, aside=0.02, apart=0.12))


def _disassemble(see: Sight) -> Move:
    wrench = shifted(see.first, -0.02, 0.0, 0.01)
    up = shifted(see.hand, z=0.1)
    aim = approach(see, wrench, up, aside=0.02, over=0.1, apart=0.03)
    return Move(aim, 10.0, grip(see, wrench, 0.0, 0.8, aside=0.02, apart=0.07))


def _basketball(see: Sight) -> Move:
    hand, ball = see.hand, shifted(see.first, z=0.01)
    hoop = at(see.goal[:, 0], 0.875, 0.35)
    raised = at(hand[:, 0], hand[:, 1], hoop[:, 2])
    then = choose(hoop, (off(ball, hoop, 0.025), raised))
    aim = approach(see, ball, then, aside=0.04, over=0.3, apart=0.025)
    return Move(aim, 25.0, grip(see, see.first, -1.0, 0.6, aside=0.04, apart=0.15))


def _bin_picking(see: Sight) -> Move:
    hand, cube = see.hand, shifted(see.first, z=0.03)
    cube[:, 1] = np.maximum(0.675, np.minimum(cube[:, 1], 0.725))
    there = np.array([0.12, 0.7, 0.02])
    beside = far(hand, there[None], 0.02)
    then = choose(
        np.broadcast_to(there, hand.shape),
        (beside & (hand[:, 2] < 0.15), shifted(hand, z=0.1)),
        (beside, at(0.12, 0.7, 0.18)),
    )
    aim = approach(see, cube, then, aside=0.02, over=0.15, apart=0.01)
    return Move(aim, 25.0, grip(see, cube, -1.0, 0.6, aside=0.02, apart=0.02))


def _box_close(see: Sight) -> Move:
    hand, lid = see.hand, shifted(see.first, z=0.02)
    box = at(see.goal[:, 0], see.goal[:, 1], 0.15)
    aim = choose(
        box,
        (far(hand, lid, 0.01), at(lid[:, 0], lid[:, 1], 0.2)),
        (off(hand, lid, 0.05), lid),
        (off(hand, box, 0.04), at(hand[:, 0], hand[:, 1], box[:, 2])),
    )
    return Move(aim, 25.0, grip(see, lid, 0.5, 1.0, aside=0.01, apart=0.13))


def _coffee_pull(see: Sight) -> Move:
    mug, held = shifted(see.first, -0.005, 0.0, 0.05), shifted(see.first, 0.01, 0.0, 0.05)
    aim = approach(see, mug, see.goal, aside=0.06, over=0.15, apart=0.02)
    return Move(aim, 10.0, grip(see, held, -1.0, 0.7, aside=0.06, apart=0.1))


def _coffee_push(see: Sight) -> Move:
    mug = shifted(see.first, 0.01, 0.0, 0.05)
    there = at(see.goal[:, 0], see.goal[:, 1], 0.1)
    aim = approach(see, mug, there, aside=0.06, over=0.2, apart=0.02)
    return Move(aim, 10.0, grip(see, mug, -1.0, 0.5, aside=0.06, apart=0.1))


def _hammer(see: Sight) -> Move:
    hand, hammer = see.hand, shifted(see.first, -0.04, 0.0, -0.01)
    nail = np.broadcast_to(np.array([0.24, 0.71, 0.11]) + np.array([-0.19, 0.0, 0.05]), hand.shape)
    aim = choose(
        nail,
        (far(hand, hammer, 0.04), shifted(hammer, z=0.1)),
        (off(hand, hammer, 0.05) & (hammer[:, 2] < 0.03), shifted(hammer, z=0.03)),
        (far_in_plane(hand, nail, 0.02), at(nail[:, 0], hand[:, 1], nail[:, 2])),
    )
    return Move(aim, 10.0, grip(see, hammer, 0.0, 0.8, aside=0.04, apart=0.1))


def _hand_insert(see: Sight) -> Move:
    hand, goal = see.hand, see.goal
    over = at(goal[:, 0], goal[:, 1], hand[:, 2])
    then = choose(goal, (far(hand, goal, 0.04), over))
    aim = approach(see, see.first, then, aside=0.02, over=0.1, apart=0.05, onto=0.03)
    return Move(aim, 10.0, grip(see, see.first, 0.0, 0.65, aside=0.02, apart=0.1))


def _handle_pull_side(see: Sight) -> Move:
    up = shifted(see.first, z=1.0)
    aim = approach(see, see.first, up, aside=0.04, over=0.1, apart=0.03)
    return Move(aim, 25.0, grip(see, see.first, 0.0, 0.6, aside=0.04, apart=0.04))


def _peg_insert(see: Sight) -> Move:
    peg, hole = see.first, at(-0.35, see.goal[:, 1], 0.16)
    before = shifted(hole, 0.4)
    then = choose(hole, (length((peg - hole)[:, 1:]) > 0.03, before))
    aim = approach(see, peg, then, aside=0.04, over=0.3, apart=0.025)
    return Move(aim, 25.0, grip(see, peg, -1.0, 0.6, aside=0.04, apart=0.15))


def _peg_unplug(see: Sight) -> Move:
    hand, peg = see.hand, shifted(see.first, -0.02, 0.0, 0.035)
    aim = choose(
        shifted(hand, 0.01),
        (far(hand, peg, 0.04), shifted(peg, z=0.2)),
        (np.abs(hand[:, 2] - 0.15) > 0.02, at(peg[:, 0], peg[:, 1], 0.15)),
    )
    return Move(aim, 25.0, grip(see, peg, -1.0, 0.1, aside=0.04, apart=0.15))


def _pick_out_of_hole(see: Sight) -> Move:
    hand, goal, puck = see.hand, see.goal, shifted(see.first, z=0.02)
    up = at(hand[:, 0], hand[:, 1], goal[:, 2])
    then = choose(goal, (off(hand, goal, 0.04), up))
    aim = approach(see, puck, then, aside=0.02, over=0.15, apart=0.01)
    return Move(aim, 25.0, grip(see, puck, 0.0, 0.1, aside=0.02, apart=0.15))


def _pick_place(see: Sight) -> Move:
    hand, puck = see.hand, shifted(see.first, -0.005)
    aim = choose(
        see.goal,
        (far(hand, puck, 0.02), shifted(puck, z=0.1)),
        (off(hand, puck, 0.05) & (puck[:, 2] < 0.04), shifted(puck, z=0.03)),
        (see.opening > 0.73, hand),
    )
    return Move(aim, 10.0, np.where(length(hand - see.first) < 0.07, 1.0, 0.0))


def _pick_place_wall(see: Sight) -> Move:
    hand, goal, puck = see.hand, see.goal, shifted(see.first, -0.005)
    x, y, z = hand.T
    at_wall = (x >= -0.15) & (x <= 0.35) & (y >= 0.6) & (y <= 0.8)
    aim = choose(
        goal,
        (far(hand, puck, 0.015), shifted(puck, z=0.1)),
        (off(hand, puck, 0.04) & (puck[:, 2] < 0.03), shifted(puck, z=0.03)),
        (at_wall & (z < 0.25), shifted(hand, z=1.0)),
        (at_wall & (z < 0.35), at(goal[:, 0], goal[:, 1], z)),
        (off(hand, goal, 0.01), at(x, y, goal[:, 2])),
    )
    return Move(aim, 10.0, grip(see, see.first, 0.0, 0.9, aside=0.015, apart=0.1))


def _push(see: Sight) -> Move:
    puck = shifted(see.first, -0.005)
    aim = approach(see, puck, see.goal, aside=0.02, over=0.2, apart=0.04, onto=0.03)
    return Move(aim, 10.0, grip(see, see.first, 0.0, 0.6, aside=0.02, apart=0.1))


def _push_back(see: Sight) -> Move:
    then = see.goal + at(0.0, 0.0, see.hand[:, 2])
    aim = approach(see, see.first, then, aside=0.04, over=0.3, apart=0.055)
    return Move(aim, 10.0, grip(see, see.first, 0.0, 0.9, aside=0.04, apart=0.05))


def _push_wall(see: Sight) -> Move:
    puck = shifted(see.first, -0.005)
    x, y, _ = puck.T
    before = (x >= -0.1) & (x <= 0.3) & (y >= 0.65) & (y <= 0.75)
    beside = ((x > -0.15) & (x < 0.05)) | ((x > 0.15) & (x < 0.35))
    then = choose(
        see.goal,
        (before, shifted(see.hand, -1)),
        (beside & (y >= 0.695) & (y <= 0.755), shifted(see.hand, 0, 1)),
    )
    aim = approach(see, puck, then, aside=0.02, over=0.2, apart=0.04, onto=0.03)
    return Move(aim, 10.0, grip(see, see.first, 0.0, 0.6, aside=0.02, apart=0.1))


def _shelf(see: Sight) -> Move:
    hand, block = see.hand, shifted(see.first, -0.005, 0.0, 0.015)
    shelf = see.goal[:, 0]
    then = choose(
        shifted(hand, 0.0, 0.05),
        (np.abs(hand[:, 0] - shelf) > 0.02, at(shelf, hand[:, 1], 0.3)),
        (hand[:, 2] < 0.3, shifted(hand, z=0.3)),
    )
    aim = approach(see, block, then, aside=0.04, over=0.3, apart=0.04)
    return Move(aim, 25.0, grip(see, see.first, -1.0, 0.7, aside=0.04, apart=0.15))


def _stick(see: Sight, stick: FloatArray, can: FloatArray, goal: FloatArray, gain: float) -> Move:
    """Grip the stick, bring it into the can, move both to the goal."""
    x, _, z = stick.T
    insert = choose(
        can,
        (off(stick, can, 0.02, 1), at(x, can[:, 1], z)),
        (off(stick, can, 0.02), at(x, can[:, 1], can[:, 2])),
    )
    outside = approach(see, stick, insert, aside=0.02, over=0.1, apart=0.02)
    aim = choose(goal, (off(stick, can, 0.04, 0), outside))
    return Move(aim, gain, grip(see, stick, -1.0, 0.7, aside=0.02, apart=0.1))


def _stick_push(see: Sight) -> Move:
    stick, goal = shifted(see.first, 0.015, 0.0, 0.03), shifted(see.goal, z=0.132)
    return _stick(see, stick, see.second, goal, 10.0)


def _stick_pull(see: Sight) -> Move:
    stick, can = (shifted(thing, -0.015, 0.0, 0.03) for thing in (see.first, see.second))
    return _stick(see, stick, can, shifted(see.goal, -0.05), 25.0)


def _sweep_into(see: Sight) -> Move:
    cube = shifted(see.first, -0.005, 0.0, 0.01)
    aim = approach(see, cube, see.goal, aside=0.04, over=0.3, apart=0.04)
    return Move(aim, 25.0, grip(see, see.first, -1.0, 0.7, aside=0.04, apart=0.15))


def _sweep(see: Sight) -> Move:
    cube, beyond = shifted(see.first, z=0.015), shifted(see.goal, z=0.1)
    on = approach(see, cube, beyond, aside=0.04, over=0.3, apart=0.04)
    held = np.where(see.first[:, 0] < 0.4, 0.7, -1.0)
    closed = np.where(grip(see, see.first, 0.0, 1.0, aside=0.04, apart=0.15) > 0, held, -1.0)
    return Move(choose(beyond, (see.hand[:, 0] < 0.2, on)), 25.0, closed)


GRIPPING: Mapping[str, Script] = MappingProxyType(
    {
        "assembly": _assembly,
        "disassemble": _disassemble,
        "basketball": _basketball,
        "bin-picking": _bin_picking,
        "box-close": _box_close,
        "coffee-pull": _coffee_pull,
        "coffee-push": _coffee_push,
        "hammer": _hammer,
        "hand-insert": _hand_insert,
        "handle-pull-side": _handle_pull_side,
        "peg-insert-side": _peg_insert,
        "peg-unplug-side": _peg_unplug,
        "pick-out-of-hole": _pick_out_of_hole,
        "pick-place": _pick_place,
        "pick-place-wall": _pick_place_wall,
        "push": _push,
        "push-back": _push_back,
        "push-wall": _push_wall,
        "shelf-place": _shelf,
        "stick-push": _stick_push,
        "stick-pull": _stick_pull,
        "sweep": _sweep,
        "sweep-into": _sweep_into,
    }
)
