"""Anonymous memory of drawing windows from a small and a large file.

    python benchmarks/sampler_memory.py cheetah_dir.h5 ml10.h5

Prints, per file, its size and by how much the process's anonymous memory grew while the file was
opened and 200 batches of 2 tasks x 16 windows of 20 were drawn. Mapped pages belong to the page
cache and do not count. Linux only (/proc). Each file gets a process of its own.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

BATCHES = 200


def anonymous_kb() -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("RssAnon"):
            return int(line.split()[1])
    raise SystemExit("no RssAnon in /proc/self/status")


def measure(path: Path) -> None:
    from mpdt.data.slices.sampler import WindowSampler
    from mpdt.data.store.reader import open_dataset

    before = anonymous_kb()
    dataset = open_dataset(path)
    rows = list(dataset.tasks.train_rows)[:2]
    ids = {row: dataset.select(task=row, quality="expert") for row in rows}
    sampler = WindowSampler(dataset, ids, rows, 20, 16, 0)
    for step in range(BATCHES):
        sampler.batch(step)
    grown = (anonymous_kb() - before) / 1024
    print(f"{path.name:20} {path.stat().st_size / 1e6:8.1f} MB file   {grown:6.1f} MiB grown")


def main() -> None:
    if len(sys.argv) == 3 and sys.argv[1] == "--one":
        measure(Path(sys.argv[2]))
        return
    for name in sys.argv[1:]:
        subprocess.run([sys.executable, __file__, "--one", name], check=True)


if __name__ == "__main__":
    main()
