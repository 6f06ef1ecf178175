"""Scripts: the expert of each Meta-World task, its own script or that script corrected.

Success is not return. Many of Meta-World's scripts reach the goal and go on: they push the
object past it, lift it away or let it slip, and the reward of the other 400 steps is lost. A
correction looks at one observation and takes over where the object is already where the
reward wants it; elsewhere the script's own answer stands.

    observation (39,)   0:3 hand   3 opening of the gripper   4:7 first object
                        11:14 second object   36:39 goal (visible to a script, always)
    action (4,)         0:3 displacement of the hand, 1 = 1 cm   3 effort of the gripper, 1 closes
    fingertips          0.045 m below the hand

Nothing here keeps state. What a correction does is part of its policy's hash, by `definition`:
raise `version` with any change that alters an action. Why each exists, and what it is worth:
docs/decisions/0006.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np
import numpy.typing as npt

from mpdt.data.sim.metaworld import scripted_policy

FloatArray = npt.NDArray[np.float64]

FINGERS = 0.045  # m from the hand down to the point between the fingertips
FIRST, SECOND = slice(4, 7), slice(11, 14)


class Correction(Protocol):
    """(observation (39,), the script's action (4,)) -> action (4,), not clipped."""

    def __call__(self, observation: FloatArray, action: FloatArray) -> FloatArray: ...

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

    def __call__(self, observation: FloatArray, action: FloatArray) -> FloatArray:
        thing = observation[SECOND if self.second else FIRST]
        error = np.zeros(3)
        chosen = list(self.axes)
        error[chosen] = (observation[36:39] - thing)[chosen]
        if np.linalg.norm(error) >= self.near:
            return action
        return np.append(self.gain * error, action[3])

    def definition(self) -> dict[str, object]:
        return {"steer": asdict(self) | {"axes": list(self.axes)}}


@dataclass(frozen=True)
class Rule:
    """A correction of one task as a function; see the functions below."""

    function: Callable[[FloatArray, FloatArray], FloatArray]
    version: int = 1

    def __call__(self, observation: FloatArray, action: FloatArray) -> FloatArray:
        return self.function(observation, action)

    def definition(self) -> dict[str, object]:
        return {"rule": self.function.__name__, "version": self.version}


def _parts(observation: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(hand, first object, goal), (3,) each."""
    return observation[:3], observation[FIRST], observation[36:39]


def _shift(point: FloatArray, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> FloatArray:
    shifted: FloatArray = point + np.array([x, y, z])
    return shifted


def _go(hand: FloatArray, aim: FloatArray, gain: float, effort: float) -> FloatArray:
    return np.append(gain * (aim - hand), effort)


def _press_forward(observation: FloatArray, effort: float) -> FloatArray:
    """Fingertips before the button, then forward by what the button is short of its stop.

    The reward wants the fingertips within 0.05 m of the pressed button.
    """
    hand, button, goal = _parts(observation)
    aim = _shift(button, z=FINGERS)
    if np.hypot(*(hand - aim)[[0, 2]]) > 0.02 and hand[1] < button[1] - 0.02:
        aim[1] = min(hand[1], button[1] - 0.06)
    else:
        aim[1] = hand[1] + goal[1] - button[1]
    return _go(hand, aim, 25.0, effort)


def press_open(observation: FloatArray, action: FloatArray) -> FloatArray:
    """button-press: the reward also wants the gripper open."""
    return _press_forward(observation, -1.0)


def press_closed(observation: FloatArray, action: FloatArray) -> FloatArray:
    """coffee-button: an open gripper would keep the fingertips too far from the button."""
    return _press_forward(observation, 0.3)


def press_down(observation: FloatArray, action: FloatArray) -> FloatArray:
    """Keep the handle at the goal's height instead of pressing it through to the stop."""
    hand, handle, goal = _parts(observation)
    if handle[2] >= goal[2] + 0.03:
        return action
    away = handle[:2] - hand[:2]
    return np.append(25.0 * np.append(away, goal[2] - handle[2]), action[3])


def press_down_before(observation: FloatArray, action: FloatArray) -> FloatArray:
    """The same, 0.02 m before the handle, where the script of handle-press presses."""
    shifted = observation.copy()
    shifted[5] -= 0.02
    return press_down(shifted, action)


def keep_upright(observation: FloatArray, action: FloatArray) -> FloatArray:
    """lever-pull: once the lever is nearly up, stay below it, where the reward wants the hand.

    The reward's place for the hand is (0, 0.055, 0.07) m before and below the lever.
    """
    hand, lever, goal = _parts(observation)
    if lever[2] <= goal[2] - 0.04:
        return action
    aim = np.array([lever[0], hand[1] + goal[1] - lever[1], goal[2] - 0.07])
    return _go(hand, aim, 10.0, action[3])


def pull_level(observation: FloatArray, action: FloatArray) -> FloatArray:
    """stick-pull: with the stick in the handle pull level; the script would lower it out."""
    hand, stick, goal = _parts(observation)
    handle = observation[SECOND]
    if abs(stick[0] - handle[0]) > 0.04:
        return action
    aim = np.append(hand[:2] + (goal - handle)[:2], 0.165)
    return _go(hand, aim, 10.0, action[3])


def unplug(observation: FloatArray, action: FloatArray) -> FloatArray:
    """peg-unplug-side: once it is out, hold the peg at the goal."""
    _, peg, goal = _parts(observation)
    if peg[0] <= goal[0] - 0.06:
        return action
    return np.append(10.0 * (goal - peg), action[3])


def grip_then_drag(observation: FloatArray, action: FloatArray) -> FloatArray:
    """push-back: close the gripper before moving, and keep the puck on the table."""
    hand, puck, goal = _parts(observation)
    above = _shift(puck, x=-0.005)
    if np.hypot(*(hand - above)[:2]) > 0.03:
        return _go(hand, _shift(above, z=0.2), 10.0, -1.0)
    if hand[2] - puck[2] > 0.055:
        return _go(hand, _shift(above, z=0.03), 10.0, -1.0 if hand[2] - puck[2] > 0.1 else 0.9)
    if observation[3] > 0.6:
        return np.array([0.0, 0.0, 0.0, 0.9])
    return np.append(10.0 * (goal - puck), 0.9)


def _touch(observation: FloatArray, action: FloatArray, x: float) -> FloatArray:
    """A window stays where it is: once it is there, bring the fingertips to its handle."""
    hand, handle, goal = _parts(observation)
    if abs(goal[0] - handle[0]) > 0.045:
        return action
    return _go(hand, _shift(handle, x, -0.02, FINGERS), 10.0, action[3])


def touch_handle(observation: FloatArray, action: FloatArray) -> FloatArray:
    """window-open, whose handle the hand has pushed to the right."""
    return _touch(observation, action, -0.01)


def touch_shut_handle(observation: FloatArray, action: FloatArray) -> FloatArray:
    """window-close, whose handle the hand has pushed to the left."""
    return _touch(observation, action, 0.01)


def over_the_edge(observation: FloatArray, action: FloatArray) -> FloatArray:
    """shelf-place: enter above the shelf's edge, then hold the block at the goal."""
    _, block, goal = _parts(observation)
    if block[2] < 0.2:
        return action
    error = _shift(goal, z=0.02) - block
    if error[2] > 0.015:  # still too low to go in
        error[1] = 0.0
    return np.append(10.0 * error, action[3])


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
    """

    def __init__(self, task_name: str, *, raw: bool = False) -> None:
        self._script = scripted_policy(task_name if raw else INSTEAD.get(task_name, task_name))
        self._correction = None if raw else CORRECTIONS.get(task_name)

    def act(self, observation: FloatArray) -> FloatArray:
        """Action (4,) in [-1, 1] for one observation (39,), the goal visible."""
        answer = np.asarray(self._script.get_action(observation), dtype=np.float64)
        action: FloatArray = np.clip(answer, -1.0, 1.0)
        if self._correction is None:
            return action
        corrected: FloatArray = np.clip(self._correction(observation, action), -1.0, 1.0)
        return corrected


def corrections_of(task_names: Sequence[str]) -> dict[str, object]:
    """By task, what makes its expert differ from Meta-World's script; only those that do."""
    found: dict[str, object] = {name: {"script_of": INSTEAD[name]} for name in INSTEAD}
    found |= {name: correction.definition() for name, correction in CORRECTIONS.items()}
    return {name: found[name] for name in sorted(set(task_names)) if name in found}
