"""Growth with the number of episodes, as exponents: making files, looking at them, proving them.

    python benchmarks/speed/growing.py [--keep]

The exponent of t = c n^x between the last two sizes; 1 is linear, 0 constant. Episodes have 4 or 10
steps: what is paid per episode shows, not per step. One process.

    collect, pack      simulated                                  1,000 to 40,000 episodes
    open, show, select, choose what a split keeps, windows        1,000 to 1,000,000
    add a slice, verify (every byte is read, hence linear)        1,000 to 1,000,000

Each of the last two lines runs in a process of its own, with the memory it holds beside the file's
pages at its highest. Windows: a sampler for all tasks, and its first batch of 16 of each.
"""

from __future__ import annotations

import math
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import remembering
import rounds
import synthetic

MADE = (1_000, 10_000, 40_000)
SIZES = (1_000, 10_000, 100_000, 1_000_000)
HORIZON, BLOCK, MODEL_HORIZON = 4, 500, 10
OPEN_MS = 100.0  # of a million episodes
MOST = {"collect": 1.1, "pack": 1.1, "open": 0.9, "show": 0.5, "select": 1.1, "choose": 1.1,
        "windows": 1.1, "slice": 1.1, "verify": 1.1}  # fmt: skip
"""Exponents; the seal over the tables, which opening compares, is linear in them."""


def opening(path: Path) -> Callable[[], Any]:
    from mpdt.data.store.reader import open_dataset

    return lambda: open_dataset(path)


def showing(path: Path) -> Callable[[], Any]:
    from mpdt.data.verbs.describe import describe, header_lines, level_table, reference_table

    def run() -> None:
        dataset = opening(path)()
        header_lines(describe(dataset))
        level_table(dataset)
        reference_table(dataset)

    return run


def selecting(path: Path) -> Callable[[], Any]:
    dataset = opening(path)()
    return lambda: [dataset.select(task=row, quality="expert") for row in range(len(dataset.tasks))]


def choosing(path: Path) -> Callable[[], Any]:
    from mpdt.data.slices.cut import Cut, choose

    dataset = opening(path)()
    return lambda: choose(dataset, Cut(quality=("expert",), return_top=0.1))


def windows(path: Path) -> Callable[[], Any]:
    import mpdt

    dataset = opening(path)()
    return lambda: mpdt.windows(dataset, window=5, per_task=16, seed=0).batch(0)


def slicing(path: Path) -> Callable[[], Any]:
    import numpy as np

    from mpdt.data.store.amend import add_slice

    return lambda: add_slice(path, "half", np.arange(0, opening(path)().num_episodes, 2), {})


def verifying(path: Path) -> Callable[[], Any]:
    from mpdt.data.verify.verify import verify

    def run() -> None:
        found = verify(path, skip=("replay", "claims", "leak", "quality"))
        wrong = [one for one in found.findings if one.outcome.value == "FAIL"]
        assert [one.id for one in wrong] in ([], ["returns"]), wrong  # no references in it

    return run


LOOKS = {"open": opening, "show": showing, "select": selecting, "choose": choosing,
         "windows": windows, "slice": slicing, "verify": verifying}  # fmt: skip
ONCE = ("slice", "verify")  # too long to be done several times


def one(what: str, path: Path) -> str:
    """Median seconds and the highest memory, in this process."""
    run, times = LOOKS[what](path), []
    highest = remembering.Highest()
    for _ in range(1 if what in ONCE else 5):
        began = time.perf_counter()
        run()
        times.append(time.perf_counter() - began)
    time.sleep(0.03)
    return f"{statistics.median(times)} {highest.mib}"


def look(report: rounds.Report, work: Path) -> None:
    model = work / "model.h5"
    synthetic.write(model, "cheetah_vel", 2, MODEL_HORIZON)
    found: dict[str, list[tuple[float, float]]] = {what: [] for what in LOOKS}
    for size in SIZES:
        path = work / f"{size}.h5"
        dataset = synthetic.grown(path, model, size // len(synthetic.open_dataset(model).tasks))
        assert dataset.num_episodes == size
        for what in LOOKS:
            command = [sys.executable, "-W", "ignore", __file__, "--one", what, str(path)]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            seconds, mib = map(float, done.stdout.split()[-2:])
            found[what].append((seconds, mib))
        path.unlink()
    for what, measured in found.items():
        for size, (seconds, mib) in zip(SIZES, measured, strict=True):
            most = OPEN_MS if what == "open" and size == SIZES[-1] else None
            report.fact(f"{what}, {size:,} episodes", 1e3 * seconds, "ms", most=most,
                        note=f"{mib:.0f} MiB")  # fmt: skip
        exponent(report, what, SIZES, [seconds for seconds, _ in measured])


def exponent(report: rounds.Report, what: str, sizes: Any, seconds: list[float]) -> None:
    power = math.log(seconds[-1] / seconds[-2]) / math.log(sizes[-1] / sizes[-2])
    report.fact(f"{what}: exponent", power, "", most=MOST[what])


def make(report: rounds.Report, work: Path) -> None:
    from mpdt.data.collect.job import make_job
    from mpdt.data.collect.pack import header_of, pack
    from mpdt.data.collect.parts import PartsFolder
    from mpdt.data.collect.runner import BlockRunner
    from mpdt.data.spec.catalog import load_catalog
    from mpdt.data.spec.entry import EpisodeCounts

    spec = load_catalog().get("cheetah_dir")
    seconds: dict[str, list[float]] = {"collect": [], "pack": []}
    for size in MADE:
        counts = EpisodeCounts(random=size // 2)  # of each of two tasks
        small = msgspec.structs.replace(spec, horizon=HORIZON, block=BLOCK, episodes=counts,
                                        tta={})  # fmt: skip
        job = make_job(small)
        plan = job.plan
        folder = PartsFolder(work / f"{size}.h5")
        (folder.path / "blocks").mkdir(parents=True)
        runner = BlockRunner(job, folder)
        runner(plan.of_kind("episodes")[0])  # builds the simulator
        began = time.perf_counter()
        reports = [runner(block) for block in plan.of_kind("episodes")]
        seconds["collect"].append(time.perf_counter() - began)
        began = time.perf_counter()
        pack(plan, folder, reports, header_of(job), {})
        seconds["pack"].append(time.perf_counter() - began)
        shutil.rmtree(folder.path)
        folder.target.unlink()
    for what, times in seconds.items():
        for size, spent in zip(MADE, times, strict=True):
            report.fact(f"{what}, {size:,} episodes", spent, "s")
        exponent(report, what, MADE, times)


def measure(report: rounds.Report) -> None:
    work = Path(tempfile.mkdtemp(prefix="mpdt-bench-", dir=rounds.scratch()))
    try:
        make(report, work)
        look(report, work)
    finally:
        shutil.rmtree(work)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        print(one(sys.argv[2], Path(sys.argv[3])))
    else:
        rounds.main("growing", measure, ("mpdt/data",))
