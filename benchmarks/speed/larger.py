"""Windows of a file that is larger than memory: 30 GB, of which a process may hold 2.

    python benchmarks/speed/larger.py [--rounds 5] [--keep]

The file's steps are random numbers on the disk, not holes. A process of its own, with its pages of
the file counted against the limit (a memory cgroup), draws batches of 10 tasks x 16 windows:

    cold     from all over the file, whose pages are on the disk
    warm     the same batches once more; what they touched fits
    memory   what the process holds beside those pages, at its highest

No part of `make bench`: it writes 30 GB, keeps 20 free, and deletes what it wrote. Minari's loader
reads whole episodes (`sampling.py` has it) and makes its files at a hundredth of this rate, so that
it is not beside ours here.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import remembering
import rounds
import synthetic

GIGABYTES, LIMIT_GIGABYTES, KEPT_FREE = 30, 2.0, 20
TASKS, PER_TASK, K, BATCHES = 10, 16, 20, 20
"""With what the kernel reads ahead, more batches would not stay in 2 GiB."""
GROUPS = Path("/sys/fs/cgroup")
_PIECE = 1 << 26


def fill(path: Path) -> None:
    """Random numbers in the place of the holes; the same some megabytes again and again."""
    with h5py.File(path) as file:
        steps = [file[f"steps/{name}"] for name in ("observations", "actions", "rewards")]
        places = [(rows.id.get_offset(), rows.nbytes) for rows in steps]
    piece = np.random.default_rng(0).random(_PIECE // 4, np.float32).tobytes()
    with path.open("r+b") as raw:
        for first, size in places:
            raw.seek(first)
            for done in range(0, size, _PIECE):
                raw.write(piece[: min(_PIECE, size - done)])
        raw.flush()
        os.fsync(raw.fileno())


@contextmanager
def limited(gigabytes: float) -> Iterator[Path | None]:
    """A memory cgroup of that size; None where none can be made."""
    new = (GROUPS / "cgroup.controllers").exists()
    group = GROUPS / ("" if new else "memory") / f"mpdt-bench-{os.getpid()}"
    try:
        group.mkdir()
        name = "memory.max" if new else "memory.limit_in_bytes"
        (group / name).write_text(str(int(gigabytes * 2**30)))
    except OSError as error:
        print(f"(no memory limit can be set here: {error.strerror})")
        yield None
        return
    try:
        yield group
    finally:
        time.sleep(0.5)  # the kernel takes a moment to let it go
        with suppress(OSError):
            group.rmdir()


def draw(path: Path, group: str) -> str:
    """Windows per second cold and warm, MiB held, in this process."""
    if group:
        (Path(group) / "cgroup.procs").write_text(str(os.getpid()))
    from mpdt.data.slices.sampler import WindowSampler
    from mpdt.data.store.reader import open_dataset

    dataset = open_dataset(path)
    rows = list(dataset.tasks.train_rows)[:TASKS]
    ids = {row: dataset.select(task=row, quality="expert") for row in rows}
    sampler: Any = WindowSampler(dataset, ids, rows, K, PER_TASK, 0)
    handle = os.open(path, os.O_RDONLY)
    os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)  # whoever wrote it left its pages
    highest, rates = remembering.Highest(), []
    for _ in range(2):
        began = time.perf_counter()
        for step in range(BATCHES):
            sampler.batch(step)
        rates.append(BATCHES * TASKS * PER_TASK / (time.perf_counter() - began))
    time.sleep(0.03)
    return f"{rates[0]} {rates[1]} {highest.mib}"


def measure(report: rounds.Report) -> None:
    free = shutil.disk_usage(rounds.scratch()).free / 1e9
    if free < GIGABYTES + KEPT_FREE:
        raise SystemExit(f"error: {free:.0f} GB free, {GIGABYTES + KEPT_FREE} wanted")
    work = Path(tempfile.mkdtemp(prefix="mpdt-bench-", dir=rounds.scratch()))
    try:
        model, path = work / "ml45.h5", work / "large.h5"
        synthetic.write(model, "ml45", 2, 500)
        dataset = synthetic.hollow(path, model, GIGABYTES * 10**9)
        began = time.perf_counter()
        fill(path)
        rate = dataset.num_bytes / 1e9 / (time.perf_counter() - began)
        report.fact(f"{dataset.num_bytes / 1e9:.0f} GB written and on the disk", rate, "GB/s")
        with limited(LIMIT_GIGABYTES) as group:
            command = [sys.executable, "-W", "ignore", __file__, "--one", str(path),
                       str(group or "")]  # fmt: skip
            done = subprocess.run(command, check=True, capture_output=True, text=True)
        cold, warm, mib = map(float, done.stdout.split()[-3:])
        note = f"limit of {LIMIT_GIGABYTES:g} GiB" if group else "no limit could be set"
        report.fact("windows of a cold file", cold, "windows/s", note=note)
        report.fact("windows of warm pages", warm, "windows/s", note=note)
        report.fact("held beside the file's pages, highest", mib, "MiB")
    finally:
        shutil.rmtree(work)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        print(draw(Path(sys.argv[2]), sys.argv[3]))
    else:
        rounds.main("larger", measure, ("mpdt/data",))
