"""Growth with the number of episodes: collecting, packing and opening, as exponents.

    python benchmarks/speed/growing.py [--keep]

1,000, 10,000 and 100,000 episodes of 4 steps: what is paid per episode shows, not per step.
The exponent of t = c n^x between the last two sizes; 1 is linear, 0 constant. One process.
"""

from __future__ import annotations

import math
import shutil
import statistics
import tempfile
import time
from pathlib import Path

import msgspec
import rounds

SIZES = (1_000, 10_000, 100_000)
HORIZON, BLOCK = 4, 500


def measure(report: rounds.Report) -> None:
    from mpdt.data.collect.job import make_job
    from mpdt.data.collect.pack import pack
    from mpdt.data.collect.parts import PartsFolder
    from mpdt.data.collect.runner import BlockRunner
    from mpdt.data.spec.catalog import load_catalog
    from mpdt.data.spec.entry import EpisodeCounts
    from mpdt.data.store.reader import open_dataset

    spec = load_catalog().get("cheetah_dir")
    work = Path(tempfile.mkdtemp(prefix="mpdt-bench-", dir=rounds.scratch()))
    seconds: dict[str, list[float]] = {"collect": [], "pack": [], "open": []}
    try:
        for size in SIZES:
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
            pack(plan, folder, reports, job.policies, {})
            seconds["pack"].append(time.perf_counter() - began)
            times = []
            for _ in range(9):
                began = time.perf_counter()
                open_dataset(folder.target)
                times.append(time.perf_counter() - began)
            seconds["open"].append(statistics.median(times))
            shutil.rmtree(folder.path)
        for what, times in seconds.items():
            for size, spent in zip(SIZES, times, strict=True):
                report.fact(f"{what}, {size:,} episodes", spent, "s")
            power = math.log(times[-1] / times[-2]) / math.log(SIZES[-1] / SIZES[-2])
            most = 0.3 if what == "open" else 1.1
            report.fact(f"{what}: exponent", power, "", most=most)
    finally:
        shutil.rmtree(work)


if __name__ == "__main__":
    rounds.main("growing", measure, ("mpdt/data",))
