"""Drawing windows: K = 20, 32 or 16 per task, padded, with returns-to-go, normalised observations.

    python benchmarks/speed/sampling.py [--rounds 7] [--keep]

ours     `WindowSampler.batch` from the mapped file, observations standardised
limit    the same from arrays in RAM
floor    rows of one packed array in RAM, nothing else: no pads, sums, masks or statistics
peers    a loop over episode dictionaries as Prompt-DT has it; Minari `sample_episodes`, h5py
         slices, torchrl's and d3rlpy's samplers, each cut to windows of 20. Minari, h5py and
         torchrl hand out plain windows: they are not padded, summed or normalised here

Then the same from two files that are read as one, and through torch's DataLoader with two spawned
workers, whose own memory is looked at: they map the file and hold no copy of it.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rounds
import synthetic
from sampling_peers import (
    HORIZON,  # fmt: skip
    LOOP,
    SLICES,
    Drawn,
    K,
    h5py_slices,
    peers,
    prompt_dt_loop,
)

CASES = [Drawn("ml10", 8, 32, 60, 40), Drawn("ml45", 45, 16, 20, 10)]


def sampler_of(dataset: Any, drawn: Drawn) -> Any:
    from mpdt.data.slices.sampler import WindowSampler

    rows = drawn.rows(dataset)
    ids = {row: dataset.select(task=row, quality="expert") for row in rows}
    return WindowSampler(dataset, ids, rows, K, drawn.per_task, 0)


def standardised(dataset: Any, drawn: Drawn) -> Callable[[], float]:
    """Some batches with what a training step reads; windows done."""
    sampler = sampler_of(dataset, drawn)
    # Over whole windows: numpy begins anew for every row of an array that it spreads.
    mean = np.tile(dataset.stats["observations"]["mean"].astype(np.float32), K)
    std = dataset.stats["observations"]["std"]
    scale = np.tile((1 / np.maximum(std, 1e-6)).astype(np.float32), K)
    step = 0

    def run() -> float:
        nonlocal step
        for _ in range(drawn.batches):
            batch = sampler.batch(step)
            seen = batch.observations.reshape(-1, len(mean))  # a copy of its own
            np.subtract(seen, mean, out=seen)
            np.multiply(seen, scale, out=seen)
            step += 1
        return float(drawn.batches * batch.mask[..., 0].size)

    return run


def floor(dataset: Any, drawn: Drawn) -> Callable[[], float]:
    """Rows of one array (N, D + A + 1) by index."""
    steps = dataset.steps
    rows = len(steps.actions)
    packed = np.concatenate(
        [steps.observations[:rows], steps.actions, steps.rewards[:, None]], axis=1)  # fmt: skip
    generator = np.random.default_rng(0)
    starts = generator.integers(rows - K, size=(drawn.batches, drawn.windows))
    index = starts[..., None] + np.arange(K)

    def run() -> float:
        for one in index:
            packed.take(one, axis=0)
        return float(starts.size)

    return run


def loader(dataset: Any, drawn: Drawn) -> tuple[Any, Callable[[], float]]:
    """torch's DataLoader with two spawned workers that live on, and a way to draw from it."""
    from torch.utils.data import DataLoader

    made = DataLoader(sampler_of(dataset, drawn), batch_size=None, num_workers=2,
                      sampler=range(10 * drawn.batches), prefetch_factor=4,
                      persistent_workers=True, multiprocessing_context="spawn")  # fmt: skip

    def run() -> float:
        return float(sum(batch.episodes.size for batch in made))

    return made, run


def anonymous_mib(process: int) -> float:
    """Memory that is no page of a file."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("RssAnon"))


def through_a_loader(report: rounds.Report, path: Path, drawn: Drawn) -> None:
    from mpdt.data.store.reader import open_dataset

    dataset = open_dataset(path)
    sampler, step = sampler_of(dataset, drawn), 0
    made, run = loader(dataset, drawn)

    def alone() -> float:
        nonlocal step
        for _ in range(10 * drawn.batches):
            sampler.batch(step)
            step += 1
        return float(10 * drawn.batches * drawn.windows)

    ways = [rounds.Way("mpdt, DataLoader, 2 workers", "ours", run, 0),
            rounds.Way("mpdt, no loader", "plain", alone, 0)]  # fmt: skip
    report.compare(f"{drawn.windows} windows through a DataLoader", "windows/s", ways,
                   rounds=min(3, report.rounds),
                   note="a batch crosses a pipe as bytes; the loader pays where an update"
                   " takes longer than a batch, and other cores are free")  # fmt: skip
    workers = [anonymous_mib(process.pid) for process in made._iterator._workers]
    report.fact("own memory of a worker", max(workers), "MiB",
                note=f"torch and all; file of {dataset.num_bytes / 2**20:.0f} MiB")  # fmt: skip


def from_two_files(report: rounds.Report, work: Path, drawn: Drawn) -> None:
    """Halves of the episodes in a file each, read as one, beside the file that has them all."""
    import mpdt

    halves = [work / "half-a.h5", work / "half-b.h5"]
    for first, path in zip((0, drawn.episodes // 2), halves, strict=True):
        synthetic.write(path, drawn.family, drawn.episodes // 2, HORIZON, first)
    ways = [rounds.Way("mpdt, two files as one", "ours",
                       standardised(mpdt.open(halves), drawn), 0),
            rounds.Way("mpdt, one file", "plain",
                       standardised(mpdt.open(work / f"{drawn.family}.h5"), drawn), 0)]  # fmt: skip
    report.compare(f"{drawn.windows} windows of two files", "windows/s", ways,
                   [rounds.Target("mpdt, one file", 0.8)])  # fmt: skip


def measure(report: rounds.Report) -> None:
    import torch

    from mpdt.data.store.reader import open_dataset

    torch.set_num_threads(1)
    work = Path(tempfile.mkdtemp(prefix="mpdt-bench-", dir=rounds.scratch()))
    try:
        for drawn in CASES:
            path = work / f"{drawn.family}.h5"
            dataset = synthetic.write(path, drawn.family, drawn.episodes, HORIZON)
            ways = [
                rounds.Way("mpdt, mapped file", "ours", standardised(dataset, drawn), 0),
                rounds.Way("the same from RAM", "limit",
                           standardised(open_dataset(path, preload=True), drawn), 0),
                rounds.Way("bare rows, packed, RAM", "limit", floor(dataset, drawn), 0),
                rounds.Way(LOOP, "peer", prompt_dt_loop(dataset, drawn), 0),
                rounds.Way("h5py slices", "peer", h5py_slices(path, dataset, 200), 0),
                *peers(work / drawn.family, dataset, drawn.windows),
            ]  # fmt: skip
            least = {"the same from RAM": 0.9, LOOP: 50.0, SLICES: 10.0}
            targets = [rounds.Target(way.name, least[way.name])
                       for way in ways if way.name in least]  # fmt: skip
            report.compare(f"{drawn.windows} windows of {drawn.tasks} tasks", "windows/s", ways,
                           targets)  # fmt: skip
        from_two_files(report, work, CASES[0])
        through_a_loader(report, work / f"{CASES[0].family}.h5", CASES[0])
    finally:
        shutil.rmtree(work)


if __name__ == "__main__":
    rounds.main("sampling", measure, ("mpdt/data",))
