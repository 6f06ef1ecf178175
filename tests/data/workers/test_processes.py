"""map_blocks in spawned processes: all results, errors and dead workers reported, none left."""

from __future__ import annotations

import math
import os
import platform
import re
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from mpdt.data.workers.processes import (
    THREAD_VARIABLES,
    WORKER_ENVIRONMENT,
    default_workers,
    map_blocks,
)
from mpdt.errors import MpdtError

# Workers can only be sent what they can import, so these tests use the standard library.


def test_every_item_once_whatever_the_number_of_workers() -> None:
    items = list(range(7))
    for workers in (0, 1, 2):
        assert sorted(map_blocks(math.factorial, items, workers)) == [1, 1, 2, 6, 24, 120, 720]


def test_more_workers_than_items_and_no_items() -> None:
    assert list(map_blocks(math.factorial, [4], 3)) == [24]
    assert list(map_blocks(math.factorial, [], 3)) == []


def test_workers_are_other_processes_with_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    values = list(map_blocks(os.getenv, list(THREAD_VARIABLES), 1))
    assert values == ["1"] * len(THREAD_VARIABLES)
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "OPENBLAS_NUM_THREADS" not in os.environ


@pytest.mark.skipif(platform.machine() != "x86_64", reason="a kernel of x86")
def test_workers_use_one_blas_kernel_whatever_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Prescott")
    assert list(map_blocks(os.getenv, ["OPENBLAS_CORETYPE"], 1)) == ["Haswell"]
    assert os.environ["OPENBLAS_CORETYPE"] == "Prescott"


def test_workers_never_see_ctrl_c() -> None:
    """It goes to the whole process group; the parent decides what becomes of its workers."""
    (status,) = map_blocks(Path.read_text, [Path("/proc/self/status")], 1)
    blocked = int(re.findall(r"SigBlk:\s*(\w+)", status)[0], 16)
    assert blocked >> (signal.SIGINT - 1) & 1
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_an_error_comes_home_with_its_traceback() -> None:
    with pytest.raises(ValueError, match=r"math domain error|nonnegative") as caught:
        list(map_blocks(math.sqrt, [1.0, -1.0], 1))
    assert "in a worker process" in str(caught.value.__cause__)


def test_a_worker_that_dies_is_reported() -> None:
    with pytest.raises(MpdtError, match="a worker process died; found exit code 3"):
        list(map_blocks(os._exit, [3], 1))


def test_leaving_early_ends_the_workers() -> None:
    results = map_blocks(time.sleep, [0, 600], 2)
    next(results)
    results.close()  # type: ignore[attr-defined]
    assert not subprocess.run(
        ["pgrep", "-P", str(os.getpid()), "-f", "spawn_main"], capture_output=True, text=True
    ).stdout


def test_workers_end_with_a_killed_parent(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(
        textwrap.dedent("""
        import os, sys, time
        from mpdt.data.workers.processes import map_blocks
        if __name__ == "__main__":
            results = map_blocks(time.sleep, [0, 600, 600], 2)
            next(results)
            os.system(f"pgrep -P {os.getpid()} -f spawn_main")
            sys.stdout.flush()
            time.sleep(600)
        """)
    )
    parent = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    workers = [int(parent.stdout.readline()) for _ in range(2)]
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    deadline = time.monotonic() + 10
    while any(_alive(worker) for worker in workers) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not any(_alive(worker) for worker in workers)


def _alive(pid: int) -> bool:
    try:
        status = Path(f"/proc/{pid}/stat").read_text()
    except FileNotFoundError:
        return False
    return status.rsplit(")", 1)[1].split()[0] != "Z"


def test_default_workers_is_positive() -> None:
    assert default_workers() >= 1


def test_the_command_line_computes_with_the_workers_kernel(tmp_path: Path) -> None:
    """`--workers 0` gave other bytes where OpenBLAS chooses another kernel than the pinned one."""
    code = (
        "import ctypes, glob, os\n"
        "from mpdt.data.cli import main\n"
        "assert main(['info', '--json']) == 0\n"
        "import numpy\n"
        "[path] = glob.glob(os.path.dirname(numpy.__file__) + '.libs/*openblas*')\n"
        "name = ctypes.CDLL(path).scipy_openblas_get_corename64_\n"
        "name.restype = ctypes.c_char_p\n"
        "print('KERNEL', name().decode())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    kernel = WORKER_ENVIRONMENT.get("OPENBLAS_CORETYPE")
    assert kernel is None or done.stdout.splitlines()[-1] == f"KERNEL {kernel}"
