"""Robots of gymnasium whose model is another one in every task; used by walker_ and hopper_params.

    body masses     x 1.5^u          one u per number, uniform in [-3, 3], rounded to six digits,
    body inertias   x 1.5^u          drawn from a named seed; numbers that are 0 have none
    joint damping   x 1.3^u
    geom friction   x 1.5^u

A task's goal is its u's in this order, so every file has the draw, and replays it. Reward: forward
speed minus 1e-3 |action|^2; no bonus for being upright, and no end but the horizon.

Source: rand_param_envs, as PEARL (Rakelly et al. 2019) and Meta-DT (Wang et al. 2024) use it: bases
1.5 and, of the damping, 1.3. There the model's derived constants stay those of the original.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from safetensors.numpy import load_file

import mpdt

BASES = {"body_mass": 1.5, "body_inertia": 1.5, "dof_damping": 1.3, "geom_friction": 1.5}
LIMIT = 3.0
WEIGHTS = Path(__file__).with_name("weights")
LAYERS = ("mean", "std", "w0", "b0", "w1", "b1", "w2", "b2")
NUM_TASKS, NUM_TEST = 50, 5
HORIZON = 200
PRETRAIN = {
    "steps": 600_000, "rows": NUM_TASKS, "steps_per_update": 64, "minibatch": 800, "hidden": 64,
    "snapshots": 10, "early": 12, "num_rungs": 12, "judge_episodes": 1, "threads": 1,
}  # fmt: skip
RULES: dict[str, Any] = {
    "healthy_reward": 0.0,
    "terminate_when_unhealthy": False,
    "ctrl_cost_weight": 1e-3,
}


def change(env: Any, exponents: Sequence[float]) -> Any:
    """Multiply the model's numbers; `env` is a MujocoEnv just made. Raises: ValueError."""
    model, left = env.model, np.array(exponents)
    for name, base in BASES.items():
        numbers = getattr(model, name).reshape(-1)  # a view
        places = np.flatnonzero(numbers)
        numbers[places] *= base ** left[: len(places)]
        left = left[len(places) :]
    if len(left):
        raise ValueError(f"{len(left)} exponents more than the model has numbers")
    mujoco.mj_setConst(model, env.data)  # what follows from masses
    return env


def changed_tasks(seed: int, size: int) -> tuple[mpdt.Task, ...]:
    """50 tasks, the last five for testing; `size` numbers of a model are changed."""
    draws = np.random.default_rng(seed).uniform(-LIMIT, LIMIT, (NUM_TASKS, size)).round(6)
    first_test = NUM_TASKS - NUM_TEST
    return tuple(
        mpdt.Task(f"params-{i:02d}", i, "test" if i >= first_test else "train", tuple(draw))
        for i, draw in enumerate(draws.tolist())
    )


def trained(name: str, tasks: Sequence[mpdt.Task]) -> Any:
    """The expert: of each task the best rung of `mpdt-data pretrain NAME`, by the returns that its
    record tells; (B, D) and (B, G) -> (B, A).

    The rungs know no medium one for every task: learning is too quick at first. As a script, it is
    mixed with uniform actions, at a rate that `mpdt-data calibrate` finds.
    """

    @cache
    def rungs() -> tuple[list[dict[str, Any]], dict[tuple[float, ...], int]]:
        arrays = load_file(WEIGHTS / f"{name}.safetensors")
        names = sorted({key.partition("/")[0] for key in arrays})
        told = json.loads((WEIGHTS / f"{name}.json").read_text("utf-8"))["rungs"]
        best = {task.goal: max(range(len(told)), key=lambda i: told[i]["returns"][task.name])
                for task in tasks}  # fmt: skip
        return [{key: arrays[f"{rung}/{key}"] for key in LAYERS} for rung in names], best

    def act(observations: Any, goals: Any) -> Any:
        weights, best = rungs()
        chosen = np.array([best[tuple(goal)] for goal in goals.tolist()])
        actions = np.zeros((len(observations), weights[0]["b2"].size))
        for rung in set(chosen.tolist()):
            rows, w = chosen == rung, weights[rung]
            seen = np.concatenate([observations[rows], goals[rows]], axis=1)
            x = np.clip((seen - w["mean"]) / w["std"], -10, 10).astype(np.float32)
            for layer in "01":
                x = np.tanh(x @ w[f"w{layer}"] + w[f"b{layer}"])
            actions[rows] = x @ w["w2"] + w["b2"]
        return actions

    return act


def columns(joints: Sequence[str]) -> tuple[str, ...]:
    """Of a planar robot: height, angles, their speeds."""
    return (
        "height [m]", *(f"{joint} [rad]" for joint in ("pitch", *joints)), "speed [m/s]",
        "lift [m/s]", *(f"{joint}_speed [rad/s]" for joint in ("pitch", *joints)),
    )  # fmt: skip
