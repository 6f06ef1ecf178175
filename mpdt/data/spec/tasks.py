"""One row per task of the seven families: goals, spaces, horizons, splits, return targets.

The position of a task in its family's list is part of every seed key, and so is the family
id: append, never reorder, reuse or renumber. FAMILIES gains those of one's own, see `own.py`.
"""

from __future__ import annotations

from typing import Literal

from mpdt.data.spec.family import Family as Family
from mpdt.data.spec.family import Role as Role
from mpdt.data.spec.family import Task as Task
from mpdt.data.spec.family import View
from mpdt.errors import MpdtError, unknown_name

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


_LOCOMOTION = "mpdt.data.sim.locomotion"


def _cheetah(
    name: str,
    id: int,
    reward: Literal["direction", "velocity"],
    tasks: tuple[Task, ...],
    return_target: float,
    return_scale: float,
    about: str,
) -> Family:
    return Family(
        name=name, id=id, scene=f"cheetah/{reward}", tasks=tasks, columns=_CHEETAH_COLUMNS,
        action_size=6, horizon=200, step_s=0.05,
        return_target=return_target, return_scale=return_scale,
        batch=f"{_LOCOMOTION}:LocomotionBatch", single=f"{_LOCOMOTION}_env:LocomotionEnv",
        one_step=f"{_LOCOMOTION}_step:one_step",
        inputs="mpdt.data.sim.robots:cheetah_inputs", options=frozenset({"control_cost"}),
        about=about, ends_early=False, packages=("mujoco",), steps_per_s=20_000.0,
        view=View(90.0, -15.0, 2.8, floor="floor"),
    )  # fmt: skip


_CHEETAH_DIR = _cheetah(
    "cheetah_dir", 0, "direction",
    (Task("forward", 0, "both", (1.0,)), Task("backward", 1, "both", (-1.0,))),
    1500.0, 1000.0, "A planar cheetah is to run in one of two directions",
)  # fmt: skip
_CHEETAH_VEL = _cheetah(
    "cheetah_vel", 1, "velocity", tuple(map(_velocity_task, range(40))), 0.0, 500.0,
    "A planar cheetah is to run at a given speed",
)  # fmt: skip
_ANT_DIR = Family(
    name="ant_dir", id=2, scene="ant/heading", tasks=tuple(map(_ant_task, range(50))),
    columns=_ANT_COLUMNS, action_size=8, horizon=200, step_s=0.05,
    return_target=500.0, return_scale=500.0,
    batch=f"{_LOCOMOTION}:LocomotionBatch", single=f"{_LOCOMOTION}_env:LocomotionEnv",
    one_step=f"{_LOCOMOTION}_step:one_step",
    inputs="mpdt.data.sim.robots:ant_inputs",
    options=frozenset({"control_cost", "terminate", "contact_cost"}),
    about="A four-legged ant is to run in a given direction", packages=("mujoco",),
    view=View(90.0, -30.0, 4.0, floor="floor"),
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
        name=name, id=id, scene="sawyer/metaworld", measured_in="mt50", rates="metaworld",
        tasks=tuple(Task(task, i, role, ()) for i, (task, role) in enumerate(rows)),
        columns=_SAWYER_COLUMNS, action_size=4, horizon=500, step_s=0.0125, most_steps=500,
        return_target=4500.0, return_scale=1000.0,  # HarmoDT, M3DT; per 500 steps
        batch="mpdt.data.sim.metaworld:batch_of", single="mpdt.data.sim.gym:metaworld_task",
        scripts={"metaworld": None}, scripted="mpdt.data.sim.scripted:policy_of",
        about="A robot arm does tasks of Meta-World",
        goal_hidden=goal_hidden, hidden_columns=(36, 37, 38) if goal_hidden else (),
        has_success=True,
        draws_goals=True, ends_early=False, packages=("metaworld", "mujoco"),
        # What a step costs beside the physics is nearly the same for ten rows and for fifty.
        steps_per_s=4_000.0, policy_rows=10, bundle_rows=50,
        view=View(150.0, -25.0, 1.4, at=(0.05, 0.6, 0.2)),
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


SHIPPED = tuple(FAMILIES)


def get_family(name: str) -> Family:
    """The family of that name: shipped, registered, installed or of the working folder's yaml.

    Raises: UsageError naming the nearest family; SpecError for one's own that cannot be used.
    """
    if name not in FAMILIES:
        from mpdt.data.spec.own import find_own, installed  # it registers here what it finds

        if (found := find_own(name)) is not None:
            return found
        raise unknown_name("family", name, dict.fromkeys([*FAMILIES, *installed()]))
    return FAMILIES[name]


def find_family(name: str) -> Family | None:
    """`get_family`, or None for one that is not here or cannot be used."""
    try:
        return get_family(name)
    except MpdtError:
        return None
