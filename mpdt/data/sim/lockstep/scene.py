"""Scene: what the rows of a task look like after a step, by the names of Meta-World's models.

    scene.body("obj")          (B, 3) places       scene.turn(body="obj")     (B, 4) as observed
    scene.joint("doorjoint")   (B,)                scene.kept("init_tcp")     of the reset
    scene.seen                 (B, 39) observations, clipped to the task's space

Scenes know no task; `Rules` say what of a scene a task observes and what it is worth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from mpdt.data.sim.lockstep.terms import BoolArray, FloatArray, Numbers, length
from mpdt.data.sim.rotation import quaternions

if TYPE_CHECKING:
    from mpdt.data.sim.lockstep.physics import Physics


class Scene:
    """Of the rows of one task.

    Args:
        kept: by name, what the env remembers of its reset, (B, 3) or (B,).
    """

    seen: FloatArray  # (B, 39)
    effort: npt.NDArray[np.float32]  # (B,) of the action, not clipped
    touching: BoolArray  # (B,) both fingers press the object; where the task's rules ask for it
    fingers: FloatArray  # (B, 3) the point between the fingertips

    def __init__(self, physics: Physics, kept: Mapping[str, FloatArray]) -> None:
        self._arrays, self._model, self._kept = physics.arrays, physics.model, dict(kept)
        self._positions, self.rows = physics.positions, len(physics.states)
        self._ids: dict[tuple[str, str], int] = {}

    def _id(self, kind: str, name: str) -> int:
        if (kind, name) not in self._ids:
            self._ids[kind, name] = int(getattr(self._model, kind)(name).id)
        return self._ids[kind, name]

    def body(self, name: str) -> FloatArray:
        return self._arrays["xpos"][:, self._id("body", name)]

    def site(self, name: str) -> FloatArray:
        return self._arrays["site_xpos"][:, self._id("site", name)]

    def geom(self, name: str) -> FloatArray:
        return self._arrays["geom_xpos"][:, self._id("geom", name)]

    def body_turn(self, name: str) -> FloatArray:
        """(w, x, y, z), as MuJoCo has it."""
        return self._arrays["xquat"][:, self._id("body", name)]

    def matrix_turn(self, array: str, kind: str, name: str) -> FloatArray:
        """(x, y, z, w) of a rotation matrix, as scipy has it."""
        return quaternions(self._arrays[array][:, self._id(kind, name)].reshape(-1, 3, 3))

    def joint(self, name: str) -> FloatArray:
        """The position of a joint with one, (B,)."""
        address = self._id("joint", name)
        return self._positions[:, int(self._model.jnt_qposadr[address])]

    def kept(self, name: str) -> FloatArray:
        return self._kept[name]

    def once(self, name: str, make: Callable[[], FloatArray]) -> FloatArray:
        """What `make` gave at the first step of the episode."""
        if name not in self._kept:
            self._kept[name] = make()
        return self._kept[name]

    def show(self, seen: FloatArray, effort: npt.NDArray[np.float32], touching: BoolArray) -> None:
        """The next step: what was seen after it, and the action's effort."""
        self.seen, self.effort, self.touching = seen, effort, touching
        self.fingers = (self.site("rightEndEffector") + self.site("leftEndEffector")) / 2.0

    @property
    def hand(self) -> FloatArray:
        return self.seen[:, :3]

    @property
    def opening(self) -> FloatArray:
        """Of the gripper, 0 to 1: (B,)."""
        return self.seen[:, 3]

    @property
    def thing(self) -> FloatArray:
        """The first object."""
        return self.seen[:, 4:7]

    @property
    def second(self) -> FloatArray:
        return self.seen[:, 11:14]

    @property
    def target(self) -> FloatArray:
        return self.kept("_target_pos")

    @property
    def start(self) -> FloatArray:
        """Where the object was at the reset."""
        return self.kept("obj_init_pos")

    @property
    def way(self) -> FloatArray:
        """How far that was from the target, (B,)."""
        return self.once("way", lambda: length(self.start - self.target))


Score = tuple[Numbers, BoolArray]
Points = Callable[[Scene], FloatArray]


@dataclass(frozen=True)
class Rules:
    """What a task observes and what it is worth.

    Args:
        things: per object, its place (B, 3) and its turn (B, 4).
        score: rewards (B,) and successes (B,).
        keeps: what the env remembers of its reset, beyond target, start and fingers.
        reads: arrays of the simulator, beyond the places of bodies and sites.
        goal: what is shown as goal.
        touches: the score asks whether both fingers press the object.
    """

    things: tuple[tuple[Points, Points], ...]
    score: Callable[[Scene], Score]
    keeps: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    goal: Points = lambda scene: scene.target
    touches: bool = False


def shifted(points: FloatArray, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> FloatArray:
    moved: FloatArray = points + np.array([x, y, z])
    return moved


def body(name: str, **by: float) -> Points:
    return lambda scene: shifted(scene.body(name), **by) if by else scene.body(name)


def site(name: str, **by: float) -> Points:
    return lambda scene: shifted(scene.site(name), **by) if by else scene.site(name)


def geom(name: str) -> Points:
    return lambda scene: scene.geom(name)


def body_turn(name: str) -> Points:
    return lambda scene: scene.body_turn(name)


def _matrix_turn(array: str, kind: str, name: str) -> Points:
    return lambda scene: scene.matrix_turn(array, kind, name)


geom_turn: Callable[[str], Points] = partial(_matrix_turn, "geom_xmat", "geom")
site_turn: Callable[[str], Points] = partial(_matrix_turn, "site_xmat", "site")
body_matrix_turn: Callable[[str], Points] = partial(_matrix_turn, "xmat", "body")


def turned(*quaternion: float) -> Points:
    """The same turn in every row."""
    return lambda scene: np.broadcast_to(np.array(quaternion), (scene.rows, 4))


UNTURNED = turned(0.0, 0.0, 0.0, 0.0)  # what Meta-World shows where it shows no turn
