"""Walker2d of gymnasium, its masses, inertias, damping and friction another in every task."""

from __future__ import annotations

from typing import Any

from gymnasium.envs.mujoco.walker2d_v5 import Walker2dEnv

import mpdt
from mpdt_families.changed_model import (
    HORIZON,
    PRETRAIN,
    RULES,
    change,
    changed_tasks,
    columns,
    trained,
)

PARAMS_SEED = 20240903
NUM_PARAMS = 7 + 21 + 6 + 24
TASKS = changed_tasks(PARAMS_SEED, NUM_PARAMS)
JOINTS = ("thigh", "leg", "foot", "thigh_left", "leg_left", "foot_left")


def make(task: mpdt.Task) -> Any:
    """The environment of a task."""
    return change(Walker2dEnv(**RULES), task.goal)


walker_params = mpdt.Family(
    name="walker_params",
    tasks=TASKS,
    columns=columns(JOINTS),
    action_size=6,
    horizon=HORIZON,
    step_s=0.008,
    return_target=400.0,
    return_scale=200.0,
    env=make,
    scripts={"trained": trained("walker_params", TASKS)},
    pretrain=PRETRAIN,
    ends_early=False,
    packages=("mujoco",),
    about="A two-legged walker is to run, its masses, inertias, damping and friction hidden",
    steps_per_s=12_000.0,
)
