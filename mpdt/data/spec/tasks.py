"""One row per task of the seven families: goals, spaces, horizons, splits, return targets.

The position of a task in its family's list is part of every seed key, and so is the family
id: append, never reorder, reuse or renumber.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mpdt.errors import unknown_name

Role = Literal["train", "test", "both"]


@dataclass(frozen=True)
class Task:
    """One task of a family.

    Args:
        index: position in the family's fixed list; the seed key's second number.
        role: `both` = the test tasks are the training tasks.
        goal: direction (+1, -1), speed in m/s or angle in rad; empty for Meta-World, which
            draws a goal per episode.
    """

    name: str
    index: int
    role: Role
    goal: tuple[float, ...]


@dataclass(frozen=True)
class Family:
    """Tasks that share simulator, robot and spaces.

    Args:
        id: the seed key's first number.
        action_low, action_high: bounds of every action component, in the env's own unit.
        horizon: steps after which an episode is truncated.
        step_s: seconds of simulated time per step.
        return_target, return_scale: the fixed return asked for at test time and its divisor;
            for a full-length episode, in summed reward.
        goal_hidden: stored observations do not contain the goal.
        hidden_columns: observation columns that are stored as 0.
        has_success: the simulator reports success per step.
        tta_action_scale: published range of the random actions for test-time adaptation, as
            a multiple of the bounds.
        columns: `name [unit]` of every observation column; unit `1` has no dimension.
    """

    name: str
    id: int
    simulator: Literal["locomotion", "metaworld"]
    robot: Literal["cheetah", "ant", "sawyer"]
    reward: Literal["direction", "velocity", "heading", "metaworld"]
    observation_size: int
    action_size: int
    action_low: float
    action_high: float
    horizon: int
    step_s: float
    tasks: tuple[Task, ...]
    return_target: float
    return_scale: float
    goal_hidden: bool
    hidden_columns: tuple[int, ...]
    has_success: bool
    tta_action_scale: float
    columns: tuple[str, ...]

    def task(self, name_or_index: str | int) -> Task:
        """The task of that name or position.

        Raises: UsageError naming the nearest task.
        """
        for task in self.tasks:
            if name_or_index in (task.name, task.index):
                return task
        known = [task.name for task in self.tasks]
        raise unknown_name("task", str(name_or_index), known, where=self.name)


# ---- locomotion: environment code of MACAW (Mitchell et al. 2021), reused by Prompt-DT ----

_ANT_ANGLES_RAD = (
    1.20336059, 0.42663053, 4.94477548, 4.12386514, 4.00566193,
    3.61661964, 0.24543954, 2.24820918, 5.94190270, 0.37727185,
    5.42893665, 5.51217894, 0.32165929, 4.09926706, 3.46675609,
    3.75428649, 3.03809995, 1.77806705, 1.87066586, 3.52806450,
    2.48843943, 4.95555271, 2.62941494, 0.90417500, 0.94817473,
    0.34709164, 4.51156075, 1.83668411, 1.24893307, 5.22361358,
    3.56879346, 0.51735590, 3.42432703, 0.99876725, 4.25222348,
    0.74438319, 2.79599274, 5.57935818, 5.00938089, 0.42712295,
    6.03680751, 4.14190964, 4.51620333, 4.67203061, 5.57781200,
    0.84160545, 4.88187527, 5.26525596, 5.21067551, 0.18319881,
)  # fmt: skip
_ANT_TEST = (6, 17, 23, 30, 41)
_VELOCITY_TEST = (2, 7, 15, 23, 26)

_CHEETAH_JOINTS = ("bthigh", "bshin", "bfoot", "fthigh", "fshin", "ffoot")
_CHEETAH_COLUMNS = (  # qpos[1:], qvel, torso xpos (one sub-step old after a step)
    "root_z [m]", "root_pitch [rad]", *(f"{joint} [rad]" for joint in _CHEETAH_JOINTS),
    "root_x_velocity [m/s]", "root_z_velocity [m/s]", "root_pitch_velocity [rad/s]",
    *(f"{joint}_velocity [rad/s]" for joint in _CHEETAH_JOINTS),
    "torso_x [m]", "torso_y [m]", "torso_z [m]",
)  # fmt: skip
_ANT_JOINTS = tuple(f"{part}_{leg}" for leg in (1, 2, 3, 4) for part in ("hip", "ankle"))
_ANT_COLUMNS = (  # qpos[2:], qvel
    "torso_z [m]", "torso_qw [1]", "torso_qx [1]", "torso_qy [1]", "torso_qz [1]",
    *(f"{joint} [rad]" for joint in _ANT_JOINTS),
    *(f"torso_{axis}_velocity [m/s]" for axis in "xyz"),
    *(f"torso_{axis}_angular_velocity [rad/s]" for axis in "xyz"),
    *(f"{joint}_velocity [rad/s]" for joint in _ANT_JOINTS),
)  # fmt: skip


def _velocity_task(index: int) -> Task:
    # Rounded: 0.075 * 3 is 0.22499999999999998 in binary, and goals are hashed.
    goal = round(0.075 * (index + 1), 3)
    role: Role = "test" if index in _VELOCITY_TEST else "train"
    return Task(f"v{goal:.3f}", index, role, (goal,))


def _ant_task(index: int) -> Task:
    role: Role = "test" if index in _ANT_TEST else "train"
    return Task(f"dir-{index:02d}", index, role, (_ANT_ANGLES_RAD[index],))


def _cheetah(
    name: str,
    id: int,
    reward: Literal["direction", "velocity"],
    tasks: tuple[Task, ...],
    return_target: float,
    return_scale: float,
) -> Family:
    return Family(
        name=name, id=id, simulator="locomotion", robot="cheetah", reward=reward,
        observation_size=20, action_size=6, action_low=-1.0, action_high=1.0,
        horizon=200, step_s=0.05, tasks=tasks,
        return_target=return_target, return_scale=return_scale,
        goal_hidden=True, hidden_columns=(), has_success=False, tta_action_scale=1.0,
        columns=_CHEETAH_COLUMNS,
    )  # fmt: skip


_CHEETAH_DIR = _cheetah(
    "cheetah_dir", 0, "direction",
    (Task("forward", 0, "both", (1.0,)), Task("backward", 1, "both", (-1.0,))),
    1500.0, 1000.0,
)  # fmt: skip
_CHEETAH_VEL = _cheetah(
    "cheetah_vel", 1, "velocity", tuple(map(_velocity_task, range(40))), 0.0, 500.0
)
_ANT_DIR = Family(
    name="ant_dir", id=2, simulator="locomotion", robot="ant", reward="heading",
    observation_size=27, action_size=8, action_low=-1.0, action_high=1.0,
    horizon=200, step_s=0.05, tasks=tuple(map(_ant_task, range(50))),
    return_target=500.0, return_scale=500.0,
    goal_hidden=True, hidden_columns=(), has_success=False, tta_action_scale=1.0,
    columns=_ANT_COLUMNS,
)  # fmt: skip


# ---- Meta-World 3.1.1: environment id = name + "-v3"; splits of its own benchmark classes ----

_ML10_TRAIN = (
    "reach", "push", "pick-place", "door-open", "drawer-close", "button-press-topdown",
    "peg-insert-side", "window-open", "sweep", "basketball",
)  # fmt: skip
_ML10_TEST = ("drawer-open", "door-close", "shelf-place", "sweep-into", "lever-pull")
_ML45_TRAIN = (
    "assembly", "basketball", "button-press-topdown", "button-press-topdown-wall",
    "button-press", "button-press-wall", "coffee-button", "coffee-pull", "coffee-push",
    "dial-turn", "disassemble", "door-close", "door-open", "drawer-close", "drawer-open",
    "faucet-open", "faucet-close", "hammer", "handle-press-side", "handle-press",
    "handle-pull-side", "handle-pull", "lever-pull", "pick-place-wall", "pick-out-of-hole",
    "push-back", "pick-place", "plate-slide", "plate-slide-side", "plate-slide-back",
    "plate-slide-back-side", "peg-insert-side", "peg-unplug-side", "soccer", "stick-push",
    "stick-pull", "push-wall", "push", "reach-wall", "reach", "shelf-place", "sweep-into",
    "sweep", "window-open", "window-close",
)  # fmt: skip
_ML45_TEST = ("bin-picking", "box-close", "hand-insert", "door-lock", "door-unlock")
_MT10 = (
    "reach", "push", "pick-place", "door-open", "drawer-open", "drawer-close",
    "button-press-topdown", "peg-insert-side", "window-open", "window-close",
)  # fmt: skip
_MT50 = (
    "assembly", "basketball", "bin-picking", "box-close", "button-press-topdown",
    "button-press-topdown-wall", "button-press", "button-press-wall", "coffee-button",
    "coffee-pull", "coffee-push", "dial-turn", "disassemble", "door-close", "door-lock",
    "door-open", "door-unlock", "hand-insert", "drawer-close", "drawer-open", "faucet-open",
    "faucet-close", "hammer", "handle-press-side", "handle-press", "handle-pull-side",
    "handle-pull", "lever-pull", "pick-place-wall", "pick-out-of-hole", "pick-place",
    "plate-slide", "plate-slide-side", "plate-slide-back", "plate-slide-back-side",
    "peg-insert-side", "peg-unplug-side", "soccer", "stick-push", "stick-pull", "push",
    "push-wall", "push-back", "reach", "reach-wall", "shelf-place", "sweep-into", "sweep",
    "window-open", "window-close",
)  # fmt: skip

_OBJECT = (
    "object1_x [m]", "object1_y [m]", "object1_z [m]", *(f"object1_q{i} [1]" for i in range(4)),
    "object2_x [m]", "object2_y [m]", "object2_z [m]", *(f"object2_q{i} [1]" for i in range(4)),
)  # fmt: skip
_FRAME = ("hand_x [m]", "hand_y [m]", "hand_z [m]", "gripper [1]", *_OBJECT)
_SAWYER_COLUMNS = (
    *_FRAME, *(f"previous_{column}" for column in _FRAME),
    "goal_x [m]", "goal_y [m]", "goal_z [m]",
)  # fmt: skip


def _metaworld(name: str, id: int, goal_hidden: bool, **splits: tuple[str, ...]) -> Family:
    roles: dict[str, Role] = {"train": "train", "test": "test", "both": "both"}
    rows = [(task, roles[split]) for split, names in splits.items() for task in names]
    return Family(
        name=name, id=id, simulator="metaworld", robot="sawyer", reward="metaworld",
        observation_size=39, action_size=4, action_low=-1.0, action_high=1.0,
        horizon=500, step_s=0.0125,
        tasks=tuple(Task(task, i, role, ()) for i, (task, role) in enumerate(rows)),
        return_target=4500.0, return_scale=1000.0,  # HarmoDT, M3DT; per 500 steps
        goal_hidden=goal_hidden, hidden_columns=(36, 37, 38) if goal_hidden else (),
        has_success=True, tta_action_scale=3.0 if goal_hidden else 1.0,
        columns=_SAWYER_COLUMNS,
    )  # fmt: skip


FAMILIES: dict[str, Family] = {
    family.name: family
    for family in (
        _CHEETAH_DIR,
        _CHEETAH_VEL,
        _ANT_DIR,
        _metaworld("ml10", 3, True, train=_ML10_TRAIN, test=_ML10_TEST),
        _metaworld("ml45", 4, True, train=_ML45_TRAIN, test=_ML45_TEST),
        # Meta-World defines no test classes for MT: every task is both.
        _metaworld("mt10", 5, False, both=_MT10),
        _metaworld("mt50", 6, False, both=_MT50),
    )
}


def get_family(name: str) -> Family:
    """The family of that name.

    Raises: UsageError naming the nearest family.
    """
    if name not in FAMILIES:
        raise unknown_name("family", name, FAMILIES)
    return FAMILIES[name]
