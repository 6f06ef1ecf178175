"""Packing, opening and verifying files.

    python benchmarks/speed/storing.py [--rounds 5] [--keep]

pack     parts of finished blocks -> one file, read back and compared, on the disk (fsync)
limits   the same bytes written and fsynced once; their SHA-256, on one core and on all
peer     `minari.create_dataset_from_buffers` with the same episodes
open     files of 1 and 10 GB in two shapes; their steps are holes, their tables are not
verify   every check of steps and tables: without replay, and without claims, which computes anew
"""

from __future__ import annotations

import hashlib
import os
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import rounds
import synthetic

OPEN_MS = 30.0
ALL_CORES = "SHA-256 on all cores"
EPISODES = 350  # of each of ml10's tasks: half a gigabyte


def packing(work: Path, report: rounds.Report) -> Path:
    from mpdt.data.collect.job import make_job
    from mpdt.data.collect.pack import header_of, pack
    from mpdt.data.collect.parts import PartsFolder
    from mpdt.data.collect.runner import BlockReport
    from mpdt.data.spec.catalog import load_catalog
    from mpdt.data.spec.entry import EpisodeCounts

    spec = load_catalog().get("ml10")
    job = make_job(msgspec.structs.replace(spec, episodes=EpisodeCounts(expert=EPISODES), tta={}))
    plan = job.plan
    blocks = plan.of_kind("episodes")
    folder = PartsFolder(work / "packed.h5")
    (folder.path / "blocks").mkdir(parents=True)
    numbers = synthetic.Numbers(plan.family, spec.horizon)
    reports, episodes = [], []
    for block in blocks:
        made = numbers.of_block(block)
        folder.part(block).save_episodes(made)
        episodes += made
        steps = sum(episode.length for episode in made)
        reports.append(BlockReport(block, steps, np.array([e.episode_return for e in made])))
    header = replace(header_of(job), policies=synthetic.policies(plan.family))

    def ours() -> None:
        pack(plan, folder, reports, header, {})

    ours()
    size = folder.target.stat().st_size
    content = folder.target.read_bytes()

    def disk() -> None:
        with (work / "plain").open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())

    def digest() -> None:
        hashlib.sha256(content).digest()

    gigabytes = size / 1e9
    ways = [rounds.Way("mpdt", "ours", ours, gigabytes),
            rounds.Way("write + fsync", "limit", disk, gigabytes),
            rounds.Way("SHA-256", "limit", digest, gigabytes)]  # fmt: skip
    if rounds.have("minari"):
        ways.append(rounds.Way("minari, from buffers", "peer", minari_buffers(work, episodes),
                               gigabytes))  # fmt: skip
    targets = [rounds.Target("write + fsync", 0.3)]
    report.compare(f"pack {gigabytes:.2f} GB of ml10", "GB/s", ways, targets,
                   min(3, report.rounds))  # fmt: skip
    return folder.target


def minari_buffers(work: Path, episodes: list[Any]) -> Callable[[], None]:
    import minari
    from gymnasium import spaces
    from minari.data_collector import EpisodeBuffer

    os.environ["MINARI_DATASETS_PATH"] = str(work / "minari")
    columns, size = episodes[0].observations.shape[1], episodes[0].actions.shape[1]
    box = spaces.Box(-np.inf, np.inf, (columns,), np.float32)
    actions = spaces.Box(-np.inf, np.inf, (size,), np.float32)

    def run() -> None:
        with rounds.without_output():
            again()

    def again() -> None:
        buffers = [
            EpisodeBuffer(id=i, observations=e.observations, actions=e.actions, rewards=e.rewards,
                          terminations=e.terminations, truncations=e.truncations,
                          infos={"success": e.successes})
            for i, e in enumerate(episodes)
        ]  # fmt: skip
        minari.create_dataset_from_buffers(
            "bench/all-v0", buffers, action_space=actions, observation_space=box,
            algorithm_name="x", author="x", author_email="x", code_permalink="x",
            description="x")  # fmt: skip
        minari.delete_dataset("bench/all-v0")

    return run


def verifying(path: Path, report: rounds.Report) -> None:
    from mpdt.data.verify.verify import verify

    content = memoryview(path.read_bytes())
    gigabytes = len(content) / 1e9

    def ours(skip: tuple[str, ...]) -> None:
        found = verify(path, skip=("replay", "quality", *skip))  # random numbers have no quality
        assert not any(finding.id == "hash" and "FAIL" in str(finding.outcome)
                       for finding in found.findings)  # fmt: skip

    def digest() -> None:
        hashlib.sha256(content).digest()

    def all_cores(pool: ThreadPoolExecutor) -> None:
        share = -(-len(content) // rounds.cores())
        list(pool.map(lambda i: hashlib.sha256(content[i * share : (i + 1) * share]).digest(),
                      range(rounds.cores())))  # fmt: skip

    with ThreadPoolExecutor(rounds.cores()) as pool:
        report.compare(
            f"verify {gigabytes:.2f} GB without replay", "GB/s",
            [rounds.Way("mpdt", "ours", lambda: ours(("claims",)), gigabytes),
             rounds.Way("mpdt, claims too", "plain", lambda: ours(()), gigabytes),
             rounds.Way("SHA-256", "limit", digest, gigabytes),
             rounds.Way(ALL_CORES, "limit", lambda: all_cores(pool), gigabytes)],
            [rounds.Target(ALL_CORES, 0.7)], rounds=min(3, report.rounds),
            note="claims are statistics with exact quantiles, computed again",
        )  # fmt: skip
    report.fact("verify without replay", report.cases[-1]["rows"][0]["rate"], "GB/s", least=0.5)


def opening(work: Path, report: rounds.Report) -> None:
    from mpdt.data.store.reader import open_dataset

    for family, horizon in (("ml45", 500), ("cheetah_vel", 200)):
        model = work / f"{family}.h5"
        synthetic.write(model, family, 2, horizon)
        for size in (1, 10):
            path = work / f"{family}-{size}.h5"
            dataset = synthetic.hollow(path, model, size * 10**9)
            times = []
            for _ in range(4 * report.rounds):
                began = time.perf_counter()
                open_dataset(path)
                times.append(1e3 * (time.perf_counter() - began))
            report.fact(f"open {size} GB of {family}, {dataset.num_episodes:,} episodes",
                        statistics.median(times), "ms", most=OPEN_MS)  # fmt: skip


def measure(report: rounds.Report) -> None:
    work = Path(tempfile.mkdtemp(prefix="mpdt-bench-", dir=rounds.scratch()))
    try:
        verifying(packing(work, report), report)
        opening(work, report)
    finally:
        shutil.rmtree(work)


if __name__ == "__main__":
    rounds.main("storing", measure, ("mpdt/data",))
