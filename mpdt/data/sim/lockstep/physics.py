"""Physics: one MuJoCo simulator in which the rows of a task take turns.

    states (B, n)       what MuJoCo needs to go on: positions, speeds, warm start, controls, mocap
    edits               what a reset changed in the model: where bodies and sites are fixed
    arrays              what a row's scene looked like after its last step, (B, number, size)

A row is put into the simulator, stepped, read and taken out again, 5 us in all; the physics of
a step are 80 us and more. So a block needs one model and one simulator, whatever its width, and
memory stays in the cache. The bytes are those of a simulator per row: the state is all that
MuJoCo's step reads of what came before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class Physics:
    """The rows of one task.

    Args:
        reads: arrays of MjData to copy after each step, such as "xpos".
        ask: a question about the simulator after each row's step; its answers are `answers`.
    """

    def __init__(
        self,
        model: Any,
        data: Any,
        substeps: int,
        rows: int,
        reads: Sequence[str],
        ask: Callable[[], bool] | None = None,
    ) -> None:
        self.model, self.data, self._substeps = model, data, substeps
        self.states = np.zeros((rows, mujoco.mj_stateSize(model, _STATE)))
        self._fixed = (model.body_pos, model.site_pos)
        self._edits = [np.zeros((rows, *live.shape)) for live in self._fixed]
        self._views = [getattr(data, name) for name in reads]
        self.arrays = {name: np.zeros((rows, *view.shape))
                       for name, view in zip(reads, self._views, strict=True)}  # fmt: skip
        self._ask, self.answers = ask, np.zeros(rows, np.bool_)
        self.positions = self._part(mujoco.mjtState.mjSTATE_QPOS)
        self.controls = self._part(mujoco.mjtState.mjSTATE_CTRL)
        self.mocap_places = self._part(mujoco.mjtState.mjSTATE_MOCAP_POS)
        self.mocap_turns = self._part(mujoco.mjtState.mjSTATE_MOCAP_QUAT)

    def _part(self, what: Any) -> FloatArray:
        """Columns of the states, as a view."""
        before = mujoco.mj_stateSize(self.model, int(_STATE) & (int(what) - 1))
        return self.states[:, before : before + mujoco.mj_stateSize(self.model, int(what))]

    def keep(self, row: int) -> None:
        """From now on the row goes on from where the simulator stands."""
        mujoco.mj_getState(self.model, self.data, self.states[row], _STATE)
        for live, kept in zip(self._fixed, self._edits, strict=True):
            kept[row] = live

    def show(self, row: int) -> None:
        """Put the row's scene into the simulator, for a camera."""
        self._enter(row)
        mujoco.mj_forward(self.model, self.data)

    def _enter(self, row: int) -> None:
        mujoco.mj_setState(self.model, self.data, self.states[row], _STATE)
        for live, kept in zip(self._fixed, self._edits, strict=True):
            live[:] = kept[row]

    def step(self) -> None:
        """One env step of every row under its controls, and its scene into `arrays`."""
        model, data, substeps = self.model, self.data, self._substeps
        step, forward, get = mujoco.mj_step, mujoco.mj_forward, mujoco.mj_getState
        copies = list(zip(self._views, self.arrays.values(), strict=True))
        for row, state in enumerate(self.states):
            self._enter(row)
            step(model, data, nstep=substeps)
            # Meta-World does it, and it is not idle: the next step's warm start comes from here.
            forward(model, data)
            get(model, data, state, _STATE)
            for view, kept in copies:
                kept[row] = view
            if self._ask is not None:
                self.answers[row] = self._ask()
