"""The two locomotion robots: what is observed, rewarded and called a fall.

Pure functions over rows of simulator states, shared by the batched engine
(`locomotion.py`) and the gymnasium environment (`locomotion_env.py`), so both write the
same float64 numbers. B = rows.

Task code: MACAW (Mitchell et al. 2021), reused by mxu34/prompt-dt
`envs/mujoco-control-envs/mujoco_control_envs/tp_envs`.

Used by locomotion.py, locomotion_env.py, network.py, rungs.py and vecenv.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.errors import SpecError

Floats = NDArray[np.float64]

FRAME_SKIP = 5
RESET_NOISE = 0.1


@dataclass(frozen=True)
class Robot:
    """One MuJoCo model and how its state becomes an observation.

    `torso(qpos)` gives the torso position (B, 3) from positions (B, nq); `observe(qpos, qvel,
    torso)` the observation (B, D). `torso` is handed the state **one sub-step before** the
    current one after a step, and the current one after a reset: that is what `MjData.xpos`
    holds, because kinematics run at the start of a sub-step. The published data show this lag.
    """

    xml: str
    control_cost: float
    torso: Callable[[Floats], Floats]
    observe: Callable[[Floats, Floats, Floats], Floats]
    network_columns: slice

    def model(self) -> Any:
        """A fresh `mujoco.MjModel` with the solver's warm start disabled.

        Without the warm start (qpos, qvel) alone decide the next state, so batched stepping,
        `env.step` and a replay agree bit for bit.
        """
        import gymnasium
        import mujoco

        assets = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
        model = mujoco.MjModel.from_xml_path(str(assets / self.xml))
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_WARMSTART
        return model


def _cheetah_torso(qpos: Floats) -> Floats:
    # Two slide joints carry the torso body, whose rest position is (0, 0, 0.7).
    torso = np.zeros((*qpos.shape[:-1], 3))
    torso[..., 0] = qpos[..., 0]
    torso[..., 2] = 0.7 + qpos[..., 1]
    return torso


def _cheetah_observe(qpos: Floats, qvel: Floats, torso: Floats) -> Floats:
    return np.concatenate([qpos[..., 1:], qvel, torso], axis=-1)


def _ant_torso(qpos: Floats) -> Floats:
    return qpos[..., :3].copy()


def _ant_observe(qpos: Floats, qvel: Floats, torso: Floats) -> Floats:
    return np.concatenate([qpos[..., 2:], qvel], axis=-1)


ROBOTS: dict[str, Robot] = {
    "cheetah": Robot(
        "half_cheetah.xml", 0.05, _cheetah_torso, _cheetah_observe, network_columns=slice(0, 17)
    ),
    "ant": Robot("ant.xml", 0.5, _ant_torso, _ant_observe, network_columns=slice(0, 27)),
}


@dataclass(frozen=True)
class RewardRule:
    """Reward of one family with its constants.

    Speed is the change of qpos[:2] over one env step, for the ant too. The published ant code
    takes the torso body's `xpos`, which under RK4 is an inner stage of the last sub-step: it
    cannot be recomputed from stored states, and over an episode the sums differ by one
    sub-step at most.

    kind: `direction` d*v, `velocity` -|v - g|, `heading` v . (cos, sin) + alive bonus.
    terminate: end an ant's episode when its torso leaves [0.2, 1.0] m.
    """

    kind: str
    control_cost: float
    terminate: bool

    def rewards(self, speed: Floats, actions: NDArray[np.float32], goals: Floats) -> Floats:
        """Reward per row, or per row and step where the arguments have a step axis.

        speed (B, 2) in m/s along x and y, actions (B, A) float32, goals (B,): +1 or -1, m/s,
        or rad. The control cost uses the float64 value of the float32 action, in every engine.

        A cheetah at 2 m/s with all six controls at 1 earns 2 - 0.05 * 6 = 1.7 forward.
        """
        cost = self.control_cost * np.square(actions.astype(np.float64)).sum(axis=-1)
        if self.kind == "direction":
            return np.asarray(goals * speed[..., 0] - cost)
        if self.kind == "velocity":
            return np.asarray(-np.abs(speed[..., 0] - goals) - cost)
        along = speed[..., 0] * np.cos(goals) + speed[..., 1] * np.sin(goals)
        return np.asarray(along - cost + 1.0)

    def terminations(self, qpos: Floats, qvel: Floats) -> NDArray[np.bool_]:
        """(B,) bool: the ant fell or its state is not finite. Always False for a cheetah."""
        if not self.terminate:
            return np.zeros(qpos.shape[:-1], dtype=bool)
        finite = np.isfinite(qpos).all(axis=-1) & np.isfinite(qvel).all(axis=-1)
        return ~(finite & (qpos[..., 2] >= 0.2) & (qpos[..., 2] <= 1.0))


def reward_rule(robot: str, kind: str, options: Mapping[str, float | bool]) -> RewardRule:
    """The family's rule with a spec's `env` options (`control_cost`, `terminate`) applied.

    Raises: SpecError for `contact_cost: true`, which native stepping cannot deliver.
    """
    if options.get("contact_cost", False):
        raise SpecError(
            "the ant's contact cost is not simulated",
            where="env.contact_cost",
            hint="leave it out: it is part of no data set of this project",
        )
    return RewardRule(
        kind=kind,
        control_cost=float(options.get("control_cost", ROBOTS[robot].control_cost)),
        terminate=bool(options.get("terminate", robot == "ant")),
    )


def cheetah_inputs(observations: Floats, goals: Floats) -> Floats:
    """What a cheetah's behaviour network sees of observations (B, D) and goals (B, 1)."""
    return network_inputs("cheetah", "", observations, goals[:, 0])


def ant_inputs(observations: Floats, goals: Floats) -> Floats:
    """What an ant's behaviour network sees of observations (B, D) and headings (B, 1)."""
    return network_inputs("ant", "heading", observations, goals[:, 0])


def network_inputs(
    robot: str, kind: str, observations: Floats, goals: Floats
) -> NDArray[np.float64]:
    """What a behaviour network sees: observation without absolute position, and the goal.

    Absolute x is left out because it grows without bound and says nothing about the gait.
    A heading is no input: the ant is looked at from its goal's side, so all directions are
    one task from different starts. Its attitude is given as two columns of the rotation
    matrix, which are continuous where quaternions and angles jump (Zhou et al. 2019, 6D).
    """
    if kind == "heading":
        return _seen_from(observations, goals)
    columns = observations[:, ROBOTS[robot].network_columns]
    return np.concatenate([columns, goals.reshape(-1, 1)], axis=1)


def _seen_from(observations: Floats, headings: Floats) -> Floats:
    """Ant observations (B, 27) turned so that the goal (B,) lies along x: (B, 29).

    z | two columns of the attitude (6) | joints (8) | velocity (3), turned | the other rates,
    which MuJoCo gives in the torso's own frame (11).
    """
    cos, sin = np.cos(headings), np.sin(headings)

    def turned(x: Floats, y: Floats, z: Floats) -> Floats:
        return np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=1)

    w, x, y, z = observations[:, 1:5].T
    forward = turned(1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
    left = turned(2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x))
    velocity = turned(*observations[:, 13:16].T)
    rest = (observations[:, 5:13], velocity, observations[:, 16:])
    return np.concatenate([observations[:, :1], forward, left, *rest], axis=1)
