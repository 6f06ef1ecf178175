"""Reading ahead is turned off where a file is far larger than memory, and nowhere else."""

from pathlib import Path

import numpy as np
import pytest

from mpdt.data.slices import ahead
from mpdt.data.slices.sampler import WindowSampler
from mpdt.data.store.reader import open_dataset


def flags(path: Path) -> list[str]:
    """Of every map of a file in this process; `rr` says that nothing is read ahead."""
    found, ours = [], False
    for line in Path("/proc/self/smaps").read_text().splitlines():
        if "-" in line.split(" ")[0]:
            ours = line.endswith(str(path))
        elif ours and line.startswith("VmFlags:"):
            found.append(line)
    return found


def test_files_read_as_one_are_large_together(tiny_file, monkeypatch):
    size = tiny_file.stat().st_size
    maps = [np.memmap(tiny_file, np.uint8, "r") for _ in range(2)]
    monkeypatch.setattr(ahead, "memory_bytes", lambda: size * 3 // 2 // ahead.TOO_LARGE)
    ahead.read_no_further(maps[:1])
    assert not any(" rr" in line for line in flags(tiny_file))
    ahead.read_no_further(maps)
    assert sum(" rr" in line for line in flags(tiny_file)) == 2


@pytest.mark.parametrize(("memory", "told"), [(1 << 40, False), (1000, True)])
def test_only_a_file_that_is_too_large_is_not_read_ahead(tiny_file, monkeypatch, memory, told):
    monkeypatch.setattr(ahead, "memory_bytes", lambda: memory)
    data = open_dataset(tiny_file)
    rows = list(data.tasks.train_rows)
    sampler = WindowSampler(data, {row: data.select(task=row) for row in rows}, rows, 4, 2, 0)
    batch = sampler.batch(0)
    monkeypatch.setattr(ahead, "memory_bytes", lambda: 1 << 40)
    plain = open_dataset(tiny_file, preload=True)
    again = WindowSampler(plain, {row: plain.select(task=row) for row in rows}, rows, 4, 2, 0)
    np.testing.assert_array_equal(batch.observations, again.batch(0).observations)
    assert any(" rr" in line for line in flags(tiny_file)) is told


def test_a_control_group_may_allow_less_than_the_machine_has(tmp_path, monkeypatch):
    whole = ahead.memory_bytes()
    assert 0 < whole < 1 << 50
    limits = {"/proc/self/cgroup": "0::/a/b\n", "/sys/fs/cgroup/a/b/memory.max": "4096\n"}

    def read(path):
        if str(path) not in limits:
            raise FileNotFoundError
        return limits[str(path)]

    monkeypatch.setattr(Path, "read_text", read)
    assert ahead.memory_bytes() == 4096
    limits["/sys/fs/cgroup/a/b/memory.max"] = "max\n"
    assert ahead.memory_bytes() >= whole
    limits["/sys/fs/cgroup/a/memory.max"] = "5000\n"  # of the group that it is in with others
    assert ahead.memory_bytes() == 5000
    old = "4:cpu,memory:/a\n"
    limits |= {"/proc/self/cgroup": old, "/sys/fs/cgroup/memory/a/memory.limit_in_bytes": "8192\n"}
    assert ahead.memory_bytes() == 8192
