"""mpdt-data collect in processes of its own: killed, interrupted, started twice, gone on with."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from mpdt.data.collect.parts import PartsFolder
from mpdt.data.store.reader import open_dataset

SCRIPT = Path(__file__).with_name("fake_sim.py")


def start(workplace: Path, *words: str, **variables: str) -> subprocess.Popen[str]:
    """mpdt-data with the fake simulator in a session of its own, as a shell would start it."""
    return subprocess.Popen(
        [sys.executable, str(SCRIPT), *words],
        cwd=workplace, env=os.environ | variables, text=True, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 60
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)


def parts_done(target: Path) -> int:
    return len(list((PartsFolder(target).path / "blocks").glob("*.npz")))


def test_workers_kills_and_resumes_give_one_hash(collected: Path, workplace: Path) -> None:
    """0 workers (the fixture), 2 killed by SIGKILL, then 1 for the rest."""
    target = workplace / "tiny.h5"
    killed = start(workplace, "collect", "tiny", "--workers", "2", FAKE_DELAY_S="0.1")
    wait_for(lambda: parts_done(target) >= 4, killed)
    killed.kill()
    killed.communicate()
    assert not target.exists()
    left = parts_done(target)
    assert 4 <= left < 22
    rest = start(workplace, "collect", "tiny", "--workers", "1")
    out, err = rest.communicate(timeout=60)
    assert rest.returncode == 0, err
    found = re.search(r"resuming: (\d+) of 22 blocks done, 0 damaged", err)
    assert found is not None and int(found[1]) >= left
    assert open_dataset(target).content_hash == open_dataset(collected).content_hash
    assert out.startswith("packed  tiny.h5   32 episodes")
    names = sorted(path.name for path in workplace.iterdir())
    assert names == ["datasets.lock", "datasets.yaml", "tiny.h5"]


def test_a_second_collector_exits_with_4(workplace: Path) -> None:
    target = workplace / "tiny.h5"
    first = start(workplace, "collect", "tiny", "--workers", "1", FAKE_DELAY_S="600")
    wait_for((PartsFolder(target).path / "plan.json").exists, first)
    second = start(workplace, "collect", "tiny", "--workers", "1")
    err = second.communicate(timeout=60)[1]
    assert second.returncode == 4
    assert f"process {first.pid}" in err
    first.kill()
    first.communicate()


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_interrupts_print_how_to_go_on(workplace: Path, number: int, code: int) -> None:
    """Ctrl-C goes to the whole group, workers included; SIGTERM to the collector alone."""
    target = workplace / "tiny.h5"
    words = ("collect", "tiny", "--workers", "2", "--restart")
    process = start(workplace, *words, FAKE_DELAY_S="0.2")
    wait_for(lambda: parts_done(target) >= 2, process)
    if number == signal.SIGINT:
        os.killpg(process.pid, number)
    else:
        process.send_signal(number)
    err = process.communicate(timeout=30)[1]
    assert process.returncode == code
    assert "interrupted; go on with: mpdt-data collect tiny --workers 2\n" in err
    assert "Traceback" not in err
    assert parts_done(target) >= 2
    assert not target.exists()
    with PartsFolder(target).locked():
        pass  # released


def test_a_kill_during_the_pack_keeps_the_old_file(tiny_file: Path, workplace: Path) -> None:
    before = tiny_file.read_bytes()
    words = ("collect", "tiny", "--workers", "1", "--restart")
    process = start(workplace, *words, FAKE_HANG_IN_PACK="1")
    wait_for((workplace / "packing").exists, process)
    process.kill()
    process.communicate()
    assert tiny_file.read_bytes() == before
    rest = start(workplace, *words[:-1])
    assert "nothing to do" in rest.communicate(timeout=60)[0]


def test_progress_counts_only_what_this_run_did() -> None:
    from mpdt.data.collect.collect import Progress
    from mpdt.data.verbs.progress import line_writer

    now = [100.0]
    lines: list[str] = []
    tell = line_writer(lines.append, clock=lambda: now[0])

    def progress(blocks: int, last: bool = True, outdated: int = 0) -> None:
        block = type("B", (), {"label": f"b{blocks}"})() if last else None
        tell(Progress(10, 1000, blocks, 100 * blocks, 2, 200, 0, outdated, block))

    progress(2, last=False, outdated=3)
    now[0] += 4
    progress(3)  # too early for a line
    now[0] += 6
    progress(4)  # 10 s in: 200 steps of our own, 20 steps/s, 600 left = 30 s
    progress(10)  # the end always has one
    assert lines == [
        "resuming: 2 of 10 blocks done, 0 damaged, 3 made again: other rates or weights",
        "collect  4/10 blocks  400 steps  20 steps/s  eta 0:00:30  b4",
        "collect  10/10 blocks  1,000 steps  80 steps/s  eta 0:00:00  b10",
    ]
