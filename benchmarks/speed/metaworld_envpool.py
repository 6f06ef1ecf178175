"""Collecting the ten training tasks of ML10, beside EnvPool's Meta-World in C++.

    python benchmarks/speed/metaworld_envpool.py [--rounds 2] [--keep]

ours    one process per core: blocks of the shipped entry, 500 steps, two of a task side by side
        (`collect` takes five), simulated and written as parts (fsync included), with uniform
        actions and with the scripts acting
peer    EnvPool on as many threads: ready-made actions, uniform or those that our scripts made,
        nothing is written. envpool_peer.py says what else is different

Processes take the next task when they have finished one, as workers do.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import envpool_peer
import numpy as np
import rounds

ENTRY, SIDE_BY_SIDE, HORIZON, PEER_ROWS = "ml10", 2, 500, 10
ACTORS = {"uniform": ("random", "uniform actions", 1.1), "script": ("expert", "scripts", 1.0)}
"""Actor -> quality of its blocks, its name, how many times EnvPool's rate ours is to be."""


def blocks_of(quality: str) -> tuple[Any, dict[str, list[Any]]]:
    """The job of the entry, and per training task the blocks that are made in a round."""
    from mpdt.data.collect.job import make_job
    from mpdt.data.spec.catalog import load_catalog

    job = make_job(load_catalog().get(ENTRY))
    found: dict[str, list[Any]] = {}
    for block in job.plan.of_kind("episodes", quality):
        own = found.setdefault(block.task.name, [])
        if block.task.role == "train" and len(own) < SIDE_BY_SIDE:
            own.append(block)
    return job, {task: own for task, own in found.items() if own}


def ways(number: int, folder: Path) -> dict[str, Callable[[], Any]]:
    """In one worker: a round of all tasks that no other has taken, in env steps."""
    from mpdt.data.collect.parts import PartsFolder
    from mpdt.data.collect.runner import BlockRunner

    parts = PartsFolder(folder / f"{number}.h5")
    (parts.path / "blocks").mkdir(parents=True)
    made: dict[str, Callable[[], Any]] = {}
    for actor, (quality, *_) in ACTORS.items():
        job, blocks = blocks_of(quality)
        runners = {task: BlockRunner(job, parts) for task in blocks}  # each keeps its simulator
        for task, runner in runners.items():
            rows = sum(block.rows for block in blocks[task])
            runner._batch(blocks[task][0], rows)._group(task)  # builds the simulator, 0.15 s
        calls = 0

        def run(actor: str = actor, blocks: Any = blocks, runners: Any = runners) -> int:
            nonlocal calls
            calls, done = calls + 1, 0
            for task in blocks:
                try:
                    (folder / f"{actor}-{calls}-{task}").touch(exist_ok=False)
                except FileExistsError:
                    continue
                done += sum(report.steps for report in runners[task].together(blocks[task]))
            return done

        made[actor] = run
    return made


def ready_made(target: Path) -> None:
    """Actions of the scripts, (rows, steps, 4) of each task, clipped as the simulator does."""
    from mpdt.data.collect.parts import PartsFolder
    from mpdt.data.collect.runner import BlockRunner

    job, blocks = blocks_of("expert")
    runner = BlockRunner(job, PartsFolder(target.with_suffix(".h5")))
    actions = {task: np.stack([episode.actions for episode in runner.simulate(own[0])])
               for task, own in blocks.items()}  # fmt: skip
    np.savez(target, **actions)


def measure(report: rounds.Report) -> None:
    if not envpool_peer.is_there():
        return
    folder, size = (
        Path(tempfile.mkdtemp(prefix="mpdt-bench-", dir=rounds.scratch())),
        rounds.cores(),
    )
    try:
        actions = folder / "actions.npz"
        ready_made(actions)
        tasks = list(blocks_of("expert")[1])
        with (
            rounds.worker_processes(partial(ways, folder=folder), size) as team,
            envpool_peer.envpool(size, actions) as peer,
        ):
            for actor, (_, name, least) in ACTORS.items():

                def theirs(steps: int, actor: str = actor) -> float:
                    return sum(peer(f"{task}/{actor}", steps) for task in tasks)

                report.compare(
                    f"ML10's 10 training tasks, {name}, 500 steps", "env steps/s",
                    [rounds.Way("mpdt", "ours", lambda by=actor: float(sum(team(by)())), 0,
                                lambda: None),  # the workers have built their simulators
                     rounds.Way(envpool_peer.NAME, "peer", partial(theirs, PEER_ROWS * HORIZON), 0,
                                partial(theirs, PEER_ROWS))],
                    [rounds.Target(envpool_peer.NAME, least)], min(2, report.rounds),
                    "ours draws goals, resets, acts and writes; EnvPool steps ready-made actions"
                    " in MuJoCo 3.6.0",
                )  # fmt: skip
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    rounds.main("metaworld_envpool", measure, ("mpdt/data",))
