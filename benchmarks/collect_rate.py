"""Collection rate of cheetah_dir with its shipped expert, beside the native limit.

    python benchmarks/collect_rate.py [--rounds 5] [--json FILE]

limit   open-loop `mujoco.rollout` of the same episodes from the same states and actions: no
        policy, no observations, no rewards
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
from numpy.typing import NDArray

from mpdt.data.episode import Episode
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


def ours() -> tuple[Callable[[], None], NDArray[np.float64], list[Episode]]:
    """Collecting a block of expert episodes; their exact first observations; the episodes."""
    spec = load_catalog().get("cheetah_dir")
    family = get_family("cheetah_dir")
    task = family.tasks[0]
    env = make_batch(family, [task] * EPISODES)
    policy, progress = load_ladder(spec).policy(task, "expert", 0)
    keys = [SeedKey(0, family.id, 0, Quality.EXPERT, 0, row) for row in range(EPISODES)]

    def run() -> list[Episode]:
        return run_block(env, policy, keys, horizon=HORIZON, quality=2, progress=progress)

    first = env.reset(keys, env.draw_goals(keys))
    return lambda: [].extend(run()), first, run()


def native(first: NDArray[np.float64], episodes: list[Episode]) -> Callable[[], None]:
    """The same episodes again, open loop: physics alone, from the same states and actions.

    Exactly the same: a rounded start diverges, and a tumbling cheetah is slower to simulate.
    """
    model = ROBOTS["cheetah"].model()
    data = mujoco.MjData(model)
    start = np.zeros((EPISODES, 1 + model.nq + model.nv))
    start[:, 1] = first[:, 17]  # after a reset the torso's x is the root's
    start[:, 2:] = first[:, :17]
    actions = np.stack([episode.actions for episode in episodes]).astype(np.float64)
    control = actions.repeat(FRAME_SKIP, axis=1)

    def run() -> None:
        states, _ = rollout.rollout([model] * EPISODES, [data], start, control)
        last = np.stack([episode.observations[-1, 8:17] for episode in episodes])
        assert np.array_equal(states[:, -1, -model.nv :].astype(np.float32), last)

    return run


def gymnasium_env(episodes: list[Episode]) -> Callable[[], None]:
    """One environment stepped with the actions that were stored."""
    env = LocomotionEnv("cheetah_dir", "forward")

    def run() -> None:
        for number, episode in enumerate(episodes):
            env.reset(seed=number)
            for action in episode.actions:
                env.step(action)

    return run


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    collect, first, episodes = ours()
    variants = {"limit": native(first, episodes), "ours": collect, "gym": gymnasium_env(episodes)}
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
