"""Hopper of gymnasium, its masses, inertias, damping and friction another in every task."""

from __future__ import annotations

from typing import Any

from gymnasium.envs.mujoco.hopper_v5 import HopperEnv

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

PARAMS_SEED = 20240904
NUM_PARAMS = 4 + 12 + 3 + 15
TASKS = changed_tasks(PARAMS_SEED, NUM_PARAMS)
JOINTS = ("thigh", "leg", "foot")


def make(task: mpdt.Task) -> Any:
    """The environment of a task."""
    return change(HopperEnv(**RULES), task.goal)


hopper_params = mpdt.Family(
    name="hopper_params",
    tasks=TASKS,
    columns=columns(JOINTS),
    action_size=3,
    horizon=HORIZON,
    step_s=0.008,
    return_target=300.0,
    return_scale=200.0,
    env=make,
    scripts={"trained": trained("hopper_params", TASKS)},
    pretrain=PRETRAIN,
    ends_early=False,
    packages=("mujoco",),
    about="A one-legged hopper is to run, its masses, inertias, damping and friction hidden",
    steps_per_s=15_000.0,
)
