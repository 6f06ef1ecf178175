"""Collection rate of cheetah_dir with its shipped expert, beside the native limit.

    python benchmarks/collect_rate.py [--rounds 5] [--json FILE]

limit   open-loop `mujoco.rollout` of the same model and number of episodes: no policy, no
        observations, no rewards
ours    `run_block` with the shipped network: policy, clipping, rewards, episodes
gym     one `LocomotionEnv` stepped with ready-made actions, no policy

All on one thread, in interleaved rounds; the table gives medians and ratios to the limit.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[variable] = "1"

import mujoco
import numpy as np
from mujoco import rollout

from mpdt.data.sim.collect import run_block
from mpdt.data.sim.ladder import load_ladder
from mpdt.data.sim.locomotion_env import LocomotionEnv
from mpdt.data.sim.robots import FRAME_SKIP, ROBOTS
from mpdt.data.sim.simulators import make_batch
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.spec.tasks import get_family
from mpdt.seeding import Quality, SeedKey

EPISODES, HORIZON = 50, 200
STEPS = EPISODES * HORIZON


def native() -> Callable[[], None]:
    model = ROBOTS["cheetah"].model()
    data = mujoco.MjData(model)
    start = np.zeros((EPISODES, 1 + model.nq + model.nv))
    generator = np.random.Generator(np.random.PCG64(0))
    control = generator.uniform(-1, 1, (EPISODES, HORIZON, model.nu)).repeat(FRAME_SKIP, axis=1)

    def run() -> None:
        rollout.rollout([model] * EPISODES, [data], start, control)

    return run


def ours() -> Callable[[], None]:
    spec = load_catalog().get("cheetah_dir")
    family = get_family("cheetah_dir")
    task = family.tasks[0]
    env = make_batch(family, [task] * EPISODES)
    policy, progress = load_ladder(spec).policy(task, "expert", 0)
    keys = [SeedKey(0, family.id, 0, Quality.EXPERT, 0, row) for row in range(EPISODES)]

    def run() -> None:
        run_block(env, policy, keys, horizon=HORIZON, quality=2, progress=progress)

    return run


def gymnasium_env() -> Callable[[], None]:
    env = LocomotionEnv("cheetah_dir", "forward")
    generator = np.random.Generator(np.random.PCG64(0))
    actions = generator.uniform(-1, 1, (HORIZON, 6)).astype(np.float32)

    def run() -> None:
        for episode in range(EPISODES):
            env.reset(seed=episode)
            for action in actions:
                env.step(action)

    return run


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    variants = {"limit": native(), "ours": ours(), "gym": gymnasium_env()}
    rates: dict[str, list[float]] = {name: [] for name in variants}
    for run in variants.values():
        run()  # warm caches and allocators
    for _ in range(args.rounds):
        for name, run in variants.items():
            started = time.perf_counter()
            run()
            rates[name].append(STEPS / (time.perf_counter() - started))
    medians = {name: statistics.median(values) for name, values in rates.items()}
    print(f"{'path':8} {'steps/s':>10} {'of limit':>9}")
    for name, rate in medians.items():
        print(f"{name:8} {rate:10,.0f} {rate / medians['limit']:9.2f}")
    if args.json:
        versions = {"mujoco": mujoco.__version__, "numpy": np.__version__}
        record = {"steps_per_s": medians, "machine": platform.machine(), "versions": versions}
        args.json.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
