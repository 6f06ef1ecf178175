"""Collecting locomotion data: the shipped policy, random actions and TTA sets.

    python benchmarks/speed/collecting.py [--rounds 5] [--keep]

ours    one worker process per core: whole blocks, simulated and written as parts (fsync included)
limit   one process per core: open-loop `mujoco.rollout` of the same episodes from the same
        states and actions: no policy, no observations, no rewards, nothing written
peers   the same tasks as gymnasium environments, stepped with ready-made actions; no policy
        acts there and nothing is computed but the step, which is kind to them. EnvPool's robots in
        C++ on as many threads, see envpool_peer.py for what is different
"""

from __future__ import annotations

import contextlib
import itertools
import shutil
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import envpool_peer
import numpy as np
import rounds

PEER_STEPS = 1000
ENVPOOL = {"cheetah": (20_000, 2.5), "ant": (4_000, 2.0)}
"""Robot -> its steps in a round, and how many times its rate ours is to be."""
CASES = [
    # name, entry, kind of block, name of the block, targets
    ("cheetah, expert", "cheetah_dir", "episodes", "expert", 0.85),
    ("cheetah, random", "cheetah_dir", "episodes", "random", 0.95),
    ("cheetah, TTA set", "cheetah_dir", "tta", "default", 0.95),
    ("ant, expert", "ant_dir", "episodes", "expert", 0.85),
    ("ant, random", "ant_dir", "episodes", "random", 0.95),
    ("ant, TTA set", "ant_dir", "tta", "default", 0.95),
]


def block_of(entry: str, kind: str, name: str) -> tuple[Any, Any]:
    """The job of a shipped entry, and one of its blocks."""
    from mpdt.data.collect.job import make_job
    from mpdt.data.spec.catalog import load_catalog

    job = make_job(load_catalog().get(entry))
    return job, job.plan.of_kind(kind, name)[0]


def ways(number: int, entry: str, kind: str, name: str) -> dict[str, Callable[[], Any]]:
    """Ours and the limit inside one worker."""
    from mpdt.data.collect.parts import PartsFolder
    from mpdt.data.collect.runner import BlockRunner

    job, block = block_of(entry, kind, name)
    folder = PartsFolder(Path(tempfile.mkdtemp(prefix="mpdt-bench-")) / "x")
    (folder.path / "blocks").mkdir(parents=True)
    runner = BlockRunner(job, folder)
    episodes = runner.simulate(block)
    steps = sum(episode.length for episode in episodes)

    def ours() -> int:
        runner(block)
        return steps

    def clean() -> None:
        shutil.rmtree(folder.path.parent)

    return {"ours": ours, "limit": native(job.plan, block, episodes), "clean": clean}


def native(plan: Any, block: Any, episodes: list[Any]) -> Callable[[], int]:
    """The same episodes open loop, each to its own end; the final states are compared.

    Exactly the same start: a rounded one diverges, and a tumbling robot is slower to simulate.
    """
    import mujoco
    from mujoco import rollout

    from mpdt.data.sim.robots import FRAME_SKIP, ROBOTS
    from mpdt.data.sim.simulators import make_batch

    env = make_batch(plan.family, [block.task] * block.rows, plan.spec.env)
    keys = block.keys(plan.family, plan.spec.seed)
    env.reset(keys, env.draw_goals(keys))
    start = env._state.copy()
    robot = plan.family.scene.partition("/")[0]
    model = ROBOTS[robot].model()
    data = mujoco.MjData(model)
    controls = []
    for episode in episodes:
        clipped = np.clip(episode.actions, -1, 1) if block.kind == "tta" else episode.actions
        controls.append(clipped.astype(np.float64).repeat(FRAME_SKIP, axis=0)[None])
    last = slice(8, 17) if robot == "cheetah" else slice(13, 27)

    def run() -> int:
        done = 0
        for row, (control, episode) in enumerate(zip(controls, episodes, strict=True)):
            states, _ = rollout.rollout(model, data, start[row : row + 1], control)
            speeds = states[0, -1, -model.nv :].astype(np.float32)
            assert np.array_equal(speeds, episode.observations[-1, last])
            done += episode.length
        return done

    return run


def peer_ways(entry: str, actions: np.ndarray) -> list[rounds.Way]:
    """gymnasium alone, two of its environments in processes, and Minari's collector."""
    import gymnasium

    from mpdt.data.sim.locomotion_env import LocomotionEnv

    task = block_of(entry, "episodes", "expert")[1].task.name
    make = partial(LocomotionEnv, entry, task)

    def stepper(env: Any) -> Callable[[], float]:
        feed = itertools.cycle(actions)

        def run() -> float:
            env.reset(seed=0)
            for _ in range(PEER_STEPS):
                *_, terminated, truncated, _ = env.step(next(feed))
                if terminated or truncated:
                    env.reset()
            return PEER_STEPS

        return run

    def collector() -> Callable[[], float]:
        import minari

        env = gymnasium.wrappers.TimeLimit(make(), 10_000)
        env.unwrapped.spec = gymnasium.envs.registration.EnvSpec(
            "Bench-v0", entry_point="mpdt.data.sim.gym:make",
            kwargs={"family": entry, "task": task})  # fmt: skip
        return stepper(minari.DataCollector(env))

    def vector() -> Callable[[], float]:
        size = rounds.cores()
        env = gymnasium.vector.AsyncVectorEnv([make] * size)
        feed = itertools.cycle(actions)

        def run() -> float:
            env.reset(seed=0)
            for _ in range(PEER_STEPS // 4):
                env.step(np.stack([next(feed)] * size))
            return PEER_STEPS // 4 * size

        return run

    found = [rounds.Way("gymnasium, one env", "peer", stepper(make()), PEER_STEPS),
             rounds.Way(f"AsyncVectorEnv, {rounds.cores()} envs", "peer", vector(),
                        PEER_STEPS)]  # fmt: skip
    if rounds.have("jax"):
        with rounds.without_output():
            found.append(rounds.Way("Minari DataCollector", "peer", collector(), PEER_STEPS))
    return found


def measure(report: rounds.Report) -> None:
    with contextlib.ExitStack() as stack:
        peer = None
        if envpool_peer.is_there():
            peer = stack.enter_context(envpool_peer.envpool(rounds.cores()))
        for title, entry, kind, name, least in CASES:
            team = stack.enter_context(rounds.worker_processes(
                partial(ways, entry=entry, kind=kind, name=name), rounds.cores()))  # fmt: skip
            found, targets = compared(team, entry, kind, name, least)
            robot = entry.partition("_")[0]
            if peer is not None and kind == "episodes":
                steps, factor = ENVPOOL[robot]
                run = partial(peer, robot, steps)
                found.append(rounds.Way(envpool_peer.NAME, "peer", run, 0))
                targets.append(rounds.Target(envpool_peer.NAME, factor))
            report.compare(title, "env steps/s", found, targets, min(3, report.rounds))
            team("clean")()


def compared(
    team: Any, entry: str, kind: str, name: str, least: float
) -> tuple[list[rounds.Way], list[rounds.Target]]:
    """Ours, the limit and the peers of a case, but for EnvPool."""
    found = [
        rounds.Way("mpdt", "ours", lambda: sum(team("ours")()), 0),
        rounds.Way("mujoco.rollout, open loop", "limit", lambda: sum(team("limit")()), 0),
    ]
    targets = [rounds.Target("mujoco.rollout, open loop", least)]
    if name == "expert":
        size = block_of(entry, kind, name)[0].plan.family.action_size
        drawn = np.random.default_rng(0).uniform(-1, 1, (PEER_STEPS, size))
        found += peer_ways(entry, drawn.astype(np.float32))
        if entry == "cheetah_dir" and found[-1].name == "Minari DataCollector":
            targets.append(rounds.Target("Minari DataCollector", 6.0))
    return found, targets


if __name__ == "__main__":
    rounds.main("collecting", measure, ("mpdt/data",))
