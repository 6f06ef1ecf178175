"""Scripts: the expert of each Meta-World task, its own script or that script corrected.

Success is not return. Many of Meta-World's scripts reach the goal and go on: they push the
object past it, lift it away or let it slip, and the reward of the other 400 steps is lost. A
correction looks at one observation and takes over where the object is already where the
reward wants it; elsewhere the script's own answer stands.

    observation (39)   0:3 hand   3 opening of the gripper   4:7 first object
                       11:14 second object   36:39 goal (visible to a script, always)
    action (4)         0:3 displacement of the hand, 1 = 1 cm   3 effort of the gripper, 1 closes
    fingertips         0.045 m below the hand

Meta-World's own rules are in `lockstep/gripping.py` and `lockstep/pressing.py`. All answer B
observations at once and keep no state. What a correction does is part of its policy's hash, by
`definition`: raise `version` with any change that alters an action. Why each exists, and what it
is worth: docs/decisions/0006.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np

from mpdt.data.sim.lockstep.gripping import GRIPPING
from mpdt.data.sim.lockstep.pressing import PRESSING
from mpdt.data.sim.lockstep.scene import shifted
from mpdt.data.sim.lockstep.sight import Script, Sight, answer, at
from mpdt.data.sim.lockstep.terms import BoolArray, FloatArray, length
from mpdt.errors import unknown_name

SCRIPTS: Mapping[str, Script] = MappingProxyType({**GRIPPING, **PRESSING})

ACTION_SIZE = 4
FINGERS = 0.045  # m from the hand down to the point between the fingertips


class Correction(Protocol):
    """(observations (B, 39), the script's actions (B, 4)) -> actions (B, 4), not clipped."""

    def __call__(self, observations: FloatArray, actions: FloatArray) -> FloatArray: ...

    def definition(self) -> dict[str, object]:
        """What tells this correction from any other, for the policy's hash."""
        ...


@dataclass(frozen=True)
class Steer:
    """Near the goal, steer the object instead of the hand; gain 0 stands still.

        |object - goal| < near on `axes`:   displacement = gain * (goal - object) on `axes`,
                                            0 on the others; the gripper does as before

    The script aims its hand at the goal; what it holds hangs a little off, or slides on.
    """

    near: float  # m
    gain: float = 0.0  # 1 / m
    axes: tuple[int, ...] = (0, 1)
    second: bool = False  # the second object counts, not the first
    version: int = 1

    def __call__(self, observations: FloatArray, actions: FloatArray) -> FloatArray:
        see = Sight(observations)
        error = np.zeros((len(actions), 3))
        chosen = list(self.axes)
        error[:, chosen] = (see.goal - (see.second if self.second else see.first))[:, chosen]
        return _where(~(length(error) >= self.near), _act(self.gain * error, actions), actions)

    def definition(self) -> dict[str, object]:
        return {"steer": asdict(self) | {"axes": list(self.axes)}}


@dataclass(frozen=True)
class Rule:
    """A correction of one task as a function; see the functions below."""

    function: Callable[[Sight, FloatArray], FloatArray]
    version: int = 1

    def __call__(self, observations: FloatArray, actions: FloatArray) -> FloatArray:
        return self.function(Sight(observations), actions)

    def definition(self) -> dict[str, object]:
        return {"rule": self.function.__name__, "version": self.version}


def _where(condition: BoolArray, these: FloatArray, those: FloatArray) -> FloatArray:
    return np.where(condition[:, None], these, those)


def _act(way: FloatArray, effort: FloatArray | float) -> FloatArray:
    """Actions of displacements (B, 3); the effort is a number, or that of other actions."""
    if isinstance(effort, np.ndarray):
        effort = effort[:, 3]
    return np.column_stack([way, np.broadcast_to(effort, len(way))])


def _press_forward(see: Sight, effort: float) -> FloatArray:
    """Fingertips before the button, then forward by what the button is short of its stop.

    The reward wants the fingertips within 0.05 m of the pressed button.
    """
    hand, button = see.hand, see.first
    aim = shifted(button, z=FINGERS)
    beside = np.hypot(hand[:, 0] - aim[:, 0], hand[:, 2] - aim[:, 2]) > 0.02
    back = np.minimum(hand[:, 1], button[:, 1] - 0.06)
    forward = hand[:, 1] + see.goal[:, 1] - button[:, 1]
    aim[:, 1] = np.where(beside & (hand[:, 1] < button[:, 1] - 0.02), back, forward)
    return _act(25.0 * (aim - hand), effort)


def press_open(see: Sight, actions: FloatArray) -> FloatArray:
    """button-press: the reward also wants the gripper open."""
    return _press_forward(see, -1.0)


def press_closed(see: Sight, actions: FloatArray) -> FloatArray:
    """coffee-button: an open gripper would keep the fingertips too far from the button."""
    return _press_forward(see, 0.3)


def _press_down(see: Sight, handle: FloatArray, actions: FloatArray) -> FloatArray:
    x, y, _ = (handle - see.hand).T
    level = _act(25.0 * at(x, y, see.goal[:, 2] - handle[:, 2]), actions)
    return _where(handle[:, 2] >= see.goal[:, 2] + 0.03, actions, level)


def press_down(see: Sight, actions: FloatArray) -> FloatArray:
    """Keep the handle at the goal's height instead of pressing it through to the stop."""
    return _press_down(see, see.first, actions)


def press_down_before(see: Sight, actions: FloatArray) -> FloatArray:
    """The same, 0.02 m before the handle, where the script of handle-press presses."""
    return _press_down(see, shifted(see.first, y=-0.02), actions)


def keep_upright(see: Sight, actions: FloatArray) -> FloatArray:
    """lever-pull: once the lever is nearly up, stay below it, where the reward wants the hand.

    The reward's place for the hand is (0, 0.055, 0.07) m before and below the lever.
    """
    hand, lever, goal = see.hand, see.first, see.goal
    aim = at(lever[:, 0], hand[:, 1] + goal[:, 1] - lever[:, 1], goal[:, 2] - 0.07)
    up = _act(10.0 * (aim - hand), actions)
    return _where(lever[:, 2] <= goal[:, 2] - 0.04, actions, up)


def pull_level(see: Sight, actions: FloatArray) -> FloatArray:
    """stick-pull: with the stick in the handle pull level; the script would lower it out."""
    hand, goal, handle = see.hand, see.goal, see.second
    x, y, _ = (hand + (goal - handle)).T
    level = _act(10.0 * (at(x, y, 0.165) - hand), actions)
    return _where(np.abs(see.first[:, 0] - handle[:, 0]) > 0.04, actions, level)


def unplug(see: Sight, actions: FloatArray) -> FloatArray:
    """peg-unplug-side: once it is out, hold the peg at the goal."""
    peg, goal = see.first, see.goal
    return _where(peg[:, 0] <= goal[:, 0] - 0.06, actions, _act(10.0 * (goal - peg), actions))


def grip_then_drag(see: Sight, actions: FloatArray) -> FloatArray:
    """push-back: close the gripper before moving, and keep the puck on the table."""
    hand, puck = see.hand, see.first
    above = shifted(puck, x=-0.005)
    height = hand[:, 2] - puck[:, 2]
    beside = np.hypot(hand[:, 0] - above[:, 0], hand[:, 1] - above[:, 1]) > 0.03
    over = _act(10.0 * (shifted(above, z=0.2) - hand), -1.0)
    onto = _act(10.0 * (shifted(above, z=0.03) - hand), 0.9)
    onto[height > 0.1, 3] = -1.0
    wait, drag = _act(np.zeros_like(hand), 0.9), _act(10.0 * (see.goal - puck), 0.9)
    gripped = _where(see.opening > 0.6, wait, drag)
    return _where(beside, over, _where(height > 0.055, onto, gripped))


def _touch(see: Sight, actions: FloatArray, x: float) -> FloatArray:
    """A window stays where it is: once it is there, bring the fingertips to its handle."""
    handle = see.first
    there = _act(10.0 * (shifted(handle, x, -0.02, FINGERS) - see.hand), actions)
    return _where(np.abs(see.goal[:, 0] - handle[:, 0]) > 0.045, actions, there)


def touch_handle(see: Sight, actions: FloatArray) -> FloatArray:
    """window-open, whose handle the hand has pushed to the right."""
    return _touch(see, actions, -0.01)


def touch_shut_handle(see: Sight, actions: FloatArray) -> FloatArray:
    """window-close, whose handle the hand has pushed to the left."""
    return _touch(see, actions, 0.01)


def over_the_edge(see: Sight, actions: FloatArray) -> FloatArray:
    """shelf-place: enter above the shelf's edge, then hold the block at the goal."""
    error = shifted(see.goal, z=0.02) - see.first
    error[error[:, 2] > 0.015, 1] = 0.0  # still too low to go in
    return _where(see.first[:, 2] < 0.2, actions, _act(10.0 * error, actions))


CORRECTIONS: Mapping[str, Correction] = MappingProxyType(
    {
        "box-close": Steer(0.04, axes=(0, 1, 2)),
        "button-press": Rule(press_open),
        "coffee-button": Rule(press_closed),
        "coffee-push": Steer(0.08, 10.0, axes=(0, 1, 2)),
        "hammer": Steer(0.012, axes=(0, 1, 2), second=True),
        "handle-press": Rule(press_down_before),
        "handle-press-side": Rule(press_down),
        "handle-pull-side": Steer(0.03, axes=(2,)),
        "lever-pull": Rule(keep_upright),
        "peg-unplug-side": Rule(unplug),
        "pick-out-of-hole": Steer(0.06, 10.0, axes=(0, 1, 2)),
        "plate-slide-back": Steer(0.035),
        "plate-slide-back-side": Steer(0.035),
        "plate-slide-side": Steer(0.03, axes=(0,)),
        "push": Steer(0.03),
        "push-back": Rule(grip_then_drag),
        "push-wall": Steer(0.03),
        "shelf-place": Rule(over_the_edge),
        "stick-pull": Rule(pull_level),
        "stick-push": Steer(0.1, axes=(0, 1, 2), second=True),
        "sweep-into": Steer(0.1, 10.0),
        "window-close": Rule(touch_shut_handle),
        "window-open": Rule(touch_handle),
    }
)

INSTEAD: Mapping[str, str] = MappingProxyType({"button-press-topdown-wall": "button-press-topdown"})
"""Tasks that another task's script does better; its wall is not in the way."""


class Expert:
    """The best script we have for a task; see the module.

    `raw=True` leaves Meta-World's script as it is.

    Raises: UsageError for a task Meta-World has no script for.
    """

    def __init__(self, task_name: str, *, raw: bool = False) -> None:
        name = task_name if raw else INSTEAD.get(task_name, task_name)
        if name not in SCRIPTS:
            raise unknown_name("Meta-World task", task_name, SCRIPTS)
        self._script = SCRIPTS[name]
        self._correction = None if raw else CORRECTIONS.get(task_name)

    def act(self, observations: FloatArray) -> FloatArray:
        """Actions (B, 4) in [-1, 1] for observations (B, 39), the goal visible."""
        answered = answer(self._script, observations).astype(np.float64)
        actions: FloatArray = np.clip(answered, -1.0, 1.0)
        if self._correction is None:
            return actions
        corrected: FloatArray = np.clip(self._correction(observations, actions), -1.0, 1.0)
        return corrected


def corrections_of(task_names: Sequence[str]) -> dict[str, object]:
    """By task, what makes its expert differ from Meta-World's script; only those that do."""
    found: dict[str, object] = {name: {"script_of": INSTEAD[name]} for name in INSTEAD}
    found |= {name: correction.definition() for name, correction in CORRECTIONS.items()}
    return {name: found[name] for name in sorted(set(task_names)) if name in found}
