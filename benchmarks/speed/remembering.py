"""Memory: training on 1 and 10 GB, collecting and packing 1,000 and 10,000 episodes.

    python benchmarks/speed/remembering.py [--keep]

Counted is anonymous memory at its highest: pages of the mapped file belong to the page cache,
and the system takes them back when it needs them. Each measurement has a process of its own.
Linux only (/proc). The large files' steps are holes.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import rounds

UPDATES, MOST = 60, 1.15


def anonymous_mib() -> float:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("RssAnon"):
            return int(line.split()[1]) / 1024
    raise SystemExit("no RssAnon in /proc/self/status")


class Highest(threading.Thread):
    """Looks at this process every 10 ms."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.mib = 0.0
        self.start()

    def run(self) -> None:
        while True:
            self.mib = max(self.mib, anonymous_mib())
            time.sleep(0.01)


def train(path: Path) -> None:
    """Some updates of a small model; windows come from all over the file."""
    import training

    from mpdt.data.store.reader import open_dataset

    update = training.Run(open_dataset(path), "random:prompt-dt", "float32", depth=2)
    for _ in range(UPDATES):
        update.run()


def collect(target: Path, episodes: int, packs: bool) -> None:
    """Random cheetah episodes of 20 steps, blocks of 50, and on request the pack."""
    import msgspec

    from mpdt.data.collect.job import make_job
    from mpdt.data.collect.pack import header_of, pack
    from mpdt.data.collect.parts import PartsFolder
    from mpdt.data.collect.runner import BlockRunner
    from mpdt.data.spec.catalog import load_catalog
    from mpdt.data.spec.entry import EpisodeCounts

    counts = EpisodeCounts(random=episodes // 2)
    spec = msgspec.structs.replace(load_catalog().get("cheetah_dir"), horizon=20,
                                   episodes=counts, tta={})  # fmt: skip
    job, folder = make_job(spec), PartsFolder(target)
    (folder.path / "blocks").mkdir(parents=True)
    runner = BlockRunner(job, folder)
    reports = [runner(block) for block in job.plan.of_kind("episodes")]
    if packs:
        pack(job.plan, folder, reports, header_of(job), {})


def measured(*words: str) -> float:
    command = [sys.executable, __file__, "--one", *words]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return float(done.stdout.split()[-1])


def measure(report: rounds.Report) -> None:
    import synthetic

    work = Path(tempfile.mkdtemp(prefix="mpdt-bench-", dir=rounds.scratch()))
    try:
        model, found = work / "ml45.h5", {}
        synthetic.write(model, "ml45", 2, 500)
        for size in (1, 10):
            path = work / f"{size}.h5"
            synthetic.hollow(path, model, size * 10**9)
            found[size] = measured("train", str(path))
            report.fact(f"training on {size} GB, highest", found[size], "MiB")
        report.fact("10 GB over 1 GB", found[10] / found[1], "x", most=MOST)
        for what, word in (("collect", "collecting"), ("pack", "collecting and packing")):
            for episodes in (1_000, 10_000):
                target = str(work / f"{what}-{episodes}.h5")
                found[episodes] = measured(what, target, str(episodes))
                report.fact(f"{word} {episodes:,} episodes, highest", found[episodes], "MiB")
            report.fact(f"{word}: 10,000 episodes over 1,000", found[10_000] / found[1_000], "x",
                        most=MOST)  # fmt: skip
    finally:
        shutil.rmtree(work)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        highest = Highest()
        what, path, *rest = sys.argv[2:]
        if what == "train":
            train(Path(path))
        else:
            collect(Path(path), int(rest[0]), packs=what == "pack")
        time.sleep(0.05)
        print(highest.mib)
    else:
        rounds.main("remembering", measure)
