"""Training behaviour networks: PPO of stable-baselines3 on our batched simulator and on its own.

    python benchmarks/speed/pretraining.py [--rounds 3] [--keep]

ours     `FamilyVecEnv`, 256 rows, as `mpdt-data pretrain` runs it: simulate, then learn
peer     the same PPO, settings and environment on `DummyVecEnv` and `SubprocVecEnv`
limit    the simulator alone: `mujoco.rollout` on as many threads, same rows

`simulate` collects the experience of an update, policy included; `update` learns from it too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import rounds

ROWS = 256
FEW = 16  # environments of the peers
PER_UPDATE = 12_800


def ppo(env: Any, n_steps: int, epochs: int) -> Any:
    import dataclasses

    from stable_baselines3 import PPO

    from mpdt.data.sim.pretrain import SETTINGS, _ppo

    settings = dataclasses.replace(SETTINGS["cheetah_dir"], steps_per_update=n_steps,
                                   epochs=max(1, epochs))  # fmt: skip
    model = PPO("MlpPolicy", env, seed=0, device="cpu", **_ppo(settings))
    if not epochs:
        model.train = lambda: None
    return model


def learning(env: Any, rows: int, epochs: int) -> Callable[[], float]:
    """One update's worth of experience, and with `epochs` the learning from it."""
    model = ppo(env, PER_UPDATE // rows, epochs)

    def run() -> float:
        before = model.num_timesteps
        model.learn(PER_UPDATE, reset_num_timesteps=False)
        return float(model.num_timesteps - before)

    return run


def make_env() -> Any:
    from stable_baselines3.common.monitor import Monitor

    from mpdt.data.sim.locomotion_env import LocomotionEnv

    return Monitor(LocomotionEnv("cheetah_dir", "forward"))


def simulator() -> Callable[[], float]:
    """Random actions through the batched engine's physics alone."""
    import mujoco
    from mujoco import rollout

    from mpdt.data.sim.robots import FRAME_SKIP, ROBOTS

    model = ROBOTS["cheetah"].model()
    threads = rounds.cores()
    datas = [mujoco.MjData(model) for _ in range(threads)]
    steps = PER_UPDATE // ROWS
    drawn = np.random.default_rng(0).uniform(-1, 1, (ROWS, steps, model.nu))
    controls = drawn.repeat(FRAME_SKIP, axis=1)
    start = np.zeros((ROWS, 1 + model.nq + model.nv))
    pool = rollout.Rollout(nthread=threads)

    def run() -> float:
        pool.rollout([model] * ROWS, datas, start, controls)
        return float(PER_UPDATE)

    return run


def measure(report: rounds.Report) -> None:
    import torch
    from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecNormalize

    from mpdt.data.sim.vecenv import FamilyVecEnv
    from mpdt.data.spec.tasks import get_family

    torch.set_num_threads(1)
    few = min(2, report.rounds)  # a round of the peers takes longest
    family = get_family("cheetah_dir")

    def normalised(env: Any) -> Any:
        return VecNormalize(env, norm_obs=True, norm_reward=True)

    for title, epochs in (("simulate", 0), ("update", 6)):
        with rounds.without_output():
            own = normalised(FamilyVecEnv(family, ROWS, 0, rounds.cores()))
            dummy = normalised(DummyVecEnv([make_env] * FEW))
            processes = normalised(SubprocVecEnv([make_env] * FEW, start_method="spawn"))
        name = f"SB3 SubprocVecEnv, {FEW} envs"
        ways = [
            rounds.Way("mpdt", "ours", learning(own, ROWS, epochs), 0),
            rounds.Way("physics alone, open loop", "limit", simulator(), 0),
            rounds.Way(f"SB3 DummyVecEnv, {FEW} envs", "peer", learning(dummy, FEW, epochs), 0),
            rounds.Way(name, "peer", learning(processes, FEW, epochs), 0),
        ]
        dummy_name = ways[2].name
        targets = [rounds.Target(dummy_name, 4.0), rounds.Target(name, 4.0)]
        report.compare(f"PPO on cheetah_dir, {title}", "env steps/s", ways,
                       targets if epochs == 0 else [], few)  # fmt: skip
        processes.close()


if __name__ == "__main__":
    rounds.main("pretraining", measure, ("mpdt/data",))
