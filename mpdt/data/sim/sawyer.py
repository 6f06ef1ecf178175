"""QuickSawyer: Meta-World's step with less Python around the physics. Every bit stays.

Of the published step (367 us, of which 162 are physics) these are written anew:

    observation   bodies are looked up by name once; one array is filled instead of stacked
    action, sites site positions set before `mj_forward` are overwritten by it: left out
    rewards       `tolerance` on plain floats; the caging reward without (2,) arrays
    rotations     a matrix that is a rotation beyond doubt skips scipy's checks (rotation.py)
    reset         runs the model's reset twice; the first time the hand need not move home, and
                  the second time its way is remembered

A task's own methods are used as published: copies that see `tolerance` and `Rotation` from here
where their module has its own names. Nothing in metaworld itself is changed. The slow twin is the
published class (`MetaworldEnv(..., quick=False)`); all 50 tasks are compared in the tests.

Source of the slow twins: Farama-Foundation/Metaworld 3.1.1, `sawyer_xyz_env.py`,
`utils/reward_utils.py`.
"""

from __future__ import annotations

import math
from types import FunctionType, SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from mpdt.data.sim.rotation import QuickRotation

FloatArray = npt.NDArray[np.float64]

_PLANE = np.array([0, 2])  # x and z
_HAND_DOWN = np.array([1.0, 0.0, 1.0, 0.0])
_SCALARS = (float, np.float64)
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_MOST_WAYS = 256  # 2 KiB each


def tolerance(
    x: Any,
    bounds: tuple[float, float] = (0.0, 0.0),
    margin: float = 0.0,
    sigmoid: str = "gaussian",
    value_at_margin: float = 0.1,
) -> Any:
    """`reward_utils.tolerance` without arrays, for one number and the sigmoid that is used.

    Powers are `pow(y, 2.0)` as in numpy, not `y * y`, which may differ in the last bit.
    """
    if sigmoid != "long_tail" or type(x) not in _SCALARS or not margin > 0:
        from metaworld.utils import reward_utils

        return reward_utils.tolerance(x, bounds, margin, sigmoid, value_at_margin)
    lower, upper = bounds
    if lower > upper:
        raise ValueError("Lower bound must be <= upper bound.")
    if lower <= x <= upper:
        return 1.0
    distance = float(lower - x if x < lower else x - upper) / float(margin)
    scale = math.sqrt(1 / value_at_margin - 1)
    return 1 / (math.pow(distance * scale, 2.0) + 1)


class QuickSawyer:
    """Goes before a task's class; see `quick_class`. Names and results are Meta-World's."""

    data: Any
    model: Any

    def _initialize_simulation(self) -> tuple[Any, Any]:
        """Also keeps views into the simulator's memory, which stay valid as long as `data`."""
        model, data = super()._initialize_simulation()  # type: ignore[misc]
        self._bodies: dict[str, FloatArray] = {}
        self._ways_home: dict[bytes, FloatArray] = {}
        self._from_rest = False
        self._tips = (data.site("rightEndEffector").xpos, data.site("leftEndEffector").xpos)
        self._claws = (data.body("rightclaw").xpos, data.body("leftclaw").xpos)
        self._hand = data.body("hand").xpos
        self._mocap_place, self._mocap_turn = data.mocap_pos, data.mocap_quat
        return model, data

    def step(self: Any, action: npt.NDArray[np.float32]) -> tuple[Any, ...]:
        """The published step; the caller counts steps and has set a goal."""
        place = self._mocap_place
        place[0] = (place[0] + action[:3].clip(-1, 1) * self.action_scale).clip(
            self.mocap_low, self.mocap_high
        )
        self._mocap_turn[:] = _HAND_DOWN
        model, data = self.model, self.data
        data.ctrl[:] = (action[3], -action[3])
        mujoco.mj_step(model, data, nstep=self.frame_skip)
        self.curr_path_length += 1
        mujoco.mj_forward(model, data)
        space = self.sawyer_observation_space
        observation = self._last_stable_obs = self._get_obs().clip(space.low, space.high)
        reward, info = self.evaluate_state(observation, action)
        over = self.curr_path_length == self.max_path_length
        return observation.copy(), reward, False, over, info

    def _get_curr_obs_combined_no_goal(self: Any) -> FloatArray:
        seen = np.zeros(18)
        seen[:3] = self._hand
        apart = self._claws[0] - self._claws[1]
        seen[3] = min(max(math.sqrt(apart.dot(apart)) / 0.1, 0.0), 1.0)
        places, turns = self._get_pos_objects(), self._get_quat_objects()
        # Tasks may name fewer quaternions than objects: write those that there are.
        for thing in range(min(len(places) // 3, len(turns) // 4)):
            at = 4 + 7 * thing
            seen[at : at + 3] = places[3 * thing : 3 * thing + 3]
            seen[at + 3 : at + 7] = turns[4 * thing : 4 * thing + 4]
        return seen

    def _get_obs(self: Any) -> FloatArray:
        now = self._get_curr_obs_combined_no_goal()
        goal = self._get_pos_goal()
        if self._partially_observable:
            goal = np.zeros_like(goal)
        seen = np.concatenate((now, self._prev_obs, goal))
        self._prev_obs = now
        return seen

    def reset(self: Any, **options: Any) -> tuple[FloatArray, dict[str, Any]]:
        """The published reset. Its first model reset leaves edits of the model behind, which
        do not depend on where the hand is; all the rest is done again by the second."""

        def stay(steps: int = 50) -> None:
            self.init_tcp = self.tcp_center

        self._reset_hand = stay
        try:
            self.curr_path_length = 0
            self.reset_model()
        finally:
            del self._reset_hand
        mujoco.mj_resetData(self.model, self.data)
        self._from_rest = True
        observation = self.reset_model()
        self._prev_obs = observation[:18].copy()
        observation[18:36] = self._prev_obs
        return observation.astype(np.float64), {}

    def _reset_hand(self: Any, steps: int = 50) -> None:
        self._mocap_place[0] = self.hand_init_pos
        self._mocap_turn[:] = _HAND_DOWN
        self.data.ctrl[:] = (-1, 1)
        self._move_home(steps * self.frame_skip)
        self.init_tcp = self.tcp_center

    def _move_home(self: Any, substeps: int) -> None:
        """`mj_step` so often. From rest the way depends on nothing but where the model's bodies
        are fixed, so its end is kept by that; the last substep is taken always, since it
        computes what else the simulator shows."""
        model, data = self.model, self.data
        fixed = model.body_pos.tobytes() if self._from_rest else None
        self._from_rest = False
        if fixed is None or fixed not in self._ways_home:
            mujoco.mj_step(model, data, nstep=substeps - 1)
            if fixed is not None:
                if len(self._ways_home) == _MOST_WAYS:
                    self._ways_home.clear()
                end = np.zeros(mujoco.mj_stateSize(model, _STATE))
                mujoco.mj_getState(model, data, end, _STATE)
                self._ways_home[fixed] = end
        else:
            mujoco.mj_setState(model, data, self._ways_home[fixed], _STATE)
        mujoco.mj_step(model, data)

    @property
    def tcp_center(self) -> FloatArray:
        center: FloatArray = (self._tips[0] + self._tips[1]) / 2.0
        return center

    def get_endeff_pos(self) -> FloatArray:
        hand: FloatArray = self._hand
        return hand

    def get_body_com(self, body_name: str) -> FloatArray:
        found = self._bodies.get(body_name)
        if found is None:
            found = self._bodies[body_name] = self.data.body(body_name).xpos
        return found

    def _gripper_caging_reward(
        self: Any,
        action: npt.NDArray[np.float32],
        obj_pos: FloatArray,
        obj_radius: float,
        pad_success_thresh: float,
        object_reach_radius: float,
        xz_thresh: float,
        desired_gripper_effort: float = 1.0,
        high_density: bool = False,
        medium_density: bool = False,
    ) -> float:
        from metaworld.utils.reward_utils import hamacher_product

        start, bounds = self.obj_init_pos, (obj_radius, pad_success_thresh)
        now_y, start_y = float(obj_pos[1]), float(start[1])
        caging_y = hamacher_product(*(
            tolerance(
                abs(pad - now_y), bounds, abs(abs(pad - start_y) - pad_success_thresh), "long_tail"
            )
            for pad in (float(self.get_body_com(name)[1]) for name in ("leftpad", "rightpad"))
        ))  # fmt: skip
        tcp = self.tcp_center
        margin = _length((start - self.init_tcp)[_PLANE]) - xz_thresh
        caging_xz = tolerance(_length((tcp - obj_pos)[_PLANE]), (0, xz_thresh), margin, "long_tail")
        closed = min(max(0, action[-1]), desired_gripper_effort) / desired_gripper_effort
        caging = hamacher_product(caging_y, float(caging_xz))
        gripping = closed if caging > 0.97 else 0.0
        reward = hamacher_product(caging, gripping)
        if high_density:
            reward = (reward + caging) / 2
        if medium_density:
            margin = abs(_length(start - self.init_tcp) - object_reach_radius)
            reach = tolerance(_length(obj_pos - tcp), (0, object_reach_radius), margin, "long_tail")
            reward = (reward + float(reach)) / 2
        return reward  # type: ignore[no-any-return]


def _length(vector: FloatArray) -> float:
    # `np.linalg.norm` of one axis sums like this; a dot product of BLAS rounds differently.
    return math.sqrt(vector.dot(vector))


def quick_class(published: type[Any]) -> type[Any]:
    """A subclass of a task's class that does the same in less time."""
    from metaworld.sawyer_xyz_env import SawyerXYZEnv
    from metaworld.utils import reward_utils

    rewards = SimpleNamespace(**vars(reward_utils) | {"tolerance": tolerance})
    swaps = {"reward_utils": rewards, "tolerance": tolerance, "Rotation": QuickRotation}
    own: dict[str, Any] = {}
    for layer in reversed(published.__mro__):
        if issubclass(layer, SawyerXYZEnv) and layer is not SawyerXYZEnv:
            own |= {name: _seeing(value, swaps) for name, value in vars(layer).items()
                    if isinstance(value, FunctionType)}  # fmt: skip
    # Three tasks have their own: the published way home, and what no reward of version 2 reads.
    own.pop("_reset_hand", None)
    return type(published.__name__, (QuickSawyer, published), own)


def _seeing(method: FunctionType, swaps: dict[str, Any]) -> FunctionType:
    """A copy of a method whose module seems to hold other things under the names in `swaps`."""
    if method.__name__ == "inner":  # Meta-World's "is a task set?", asked at every step
        (method,) = (cell.cell_contents for cell in method.__closure__ or ())
    around = method.__globals__
    seen = around | {name: value for name, value in swaps.items() if name in around}
    copy = FunctionType(
        method.__code__, seen, method.__name__, method.__defaults__, method.__closure__
    )
    copy.__kwdefaults__ = method.__kwdefaults__
    return copy
