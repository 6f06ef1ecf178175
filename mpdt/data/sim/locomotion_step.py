"""One step of cheetah or ant from stored observations, to see whether data are of this simulator.

    cheetah   positions without x (8), velocities (9), torso (3)     x is that of the torso
    ant       positions without x and y (13), velocities (14)        x and y are 0

Neither robot's next step depends on where along the floor it is. The torso of a cheetah lags one
sub-step behind, so the column of its x is left out: nan. Stored observations are float32, so even
our own episodes come back to a few units in the sixth digit.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from mpdt.data.sim.locomotion import LocomotionBatch
from mpdt.data.spec.family import Family

Floats = NDArray[np.float64]
_CHEETAH_TORSO_X = 17


def one_step(
    family: Family,
    observations: Floats,
    actions: NDArray[np.float32],
    goals: Floats,
    options: Mapping[str, float | bool],
) -> tuple[Floats, Floats]:
    """Next observations (N, D) and rewards (N,) of observations (N, D), actions (N, A), goals."""
    rows = len(observations)
    batch = LocomotionBatch(family, [family.tasks[0]] * rows, options)
    cheetah = family.scene.startswith("cheetah")
    if cheetah:
        x, rest = observations[:, _CHEETAH_TORSO_X : _CHEETAH_TORSO_X + 1], observations[:, :17]
    else:
        x, rest = np.zeros((rows, 2)), observations
    batch.place(np.concatenate([x, rest], axis=1), goals[:, 0])
    # MuJoCo prints of states that explode, and writes a log into the working folder.
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        result = batch.step(actions)
    finally:
        mujoco.set_mju_user_warning(None)
    found = result.observations.copy()
    if cheetah:
        found[:, _CHEETAH_TORSO_X] = np.nan
    return found, result.rewards
