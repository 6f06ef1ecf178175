"""Kill `mpdt-data collect` at random moments, again and again; the file must come out the same.

    python benchmarks/trust/torture.py [--kills 100] [--seed 0] [--limit-s 1800] [--size 1]
        [--json FILE]

Each attempt is a process group of its own, stopped by SIGKILL, SIGTERM or SIGINT after a random
time, a third of them only once the pack has begun. After every kill the target must be absent or
whole. Whenever an attempt ends by itself its content hash is compared with that of an undisturbed
run, and collecting begins anew.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from mpdt.data.store.reader import open_dataset
from mpdt.errors import MpdtError

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
ENTRY = """schema: 1
datasets:
  torture:
    version: "1.0.0"
    family: cheetah_dir
    horizon: 100
    seed: 5
    block: 8
    behaviour: {{network: cheetah_dir, rungs: 5, noise: 0.1}}
    episodes: {{random: {few}, expert: {few}, history: {many}}}
    tta: {{default: {{episodes: 16}}}}
    license: CC0-1.0
"""


class Attempt:
    """One running collector, leader of its own process group."""

    def __init__(self, folder: Path) -> None:
        command = [
            sys.executable,
            "-m",
            "mpdt.data.cli",
            "collect",
            "torture",
            "-q",
            "--workers",
            "2",
        ]
        environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        self.target = folder / "torture.h5"
        self.process = subprocess.Popen(
            command, cwd=folder, start_new_session=True, env=environment,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    def phase(self) -> str:
        """Where it is, as far as the folder tells."""
        parts = self.target.with_name("torture.h5.parts")
        if self.target.exists():
            return "done"
        if self.packing():
            return "pack"
        return "blocks" if any(parts.glob("blocks/*.npz")) else "start"

    def packing(self) -> bool:
        return any(self.target.parent.glob(".torture.h5.*.tmp"))

    def wait(self, seconds: float, until_pack: bool) -> bool:
        """Wait so long, or until the pack begins; False if it ended by itself."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and self.process.poll() is None:
            if until_pack and self.packing():
                break
            time.sleep(0.002)
        return self.process.poll() is None

    def kill(self, number: signal.Signals) -> None:
        # Ctrl-C goes to the whole group; a kill hits the collector, whose workers must follow.
        if number is signal.SIGINT:
            os.killpg(self.process.pid, number)
        else:
            self.process.send_signal(number)
        self.process.communicate(timeout=120)
        self._expect_no_survivors()

    def _expect_no_survivors(self) -> None:
        for _ in range(500):
            try:
                os.killpg(self.process.pid, 0)
            except ProcessLookupError:
                return
            time.sleep(0.01)
        raise SystemExit("FAIL: workers outlive their collector")


def undisturbed(folder: Path) -> tuple[str, float]:
    """Content hash and duration of a run that nobody stops."""
    began = time.monotonic()
    attempt = Attempt(folder)
    _, text = attempt.process.communicate()
    if attempt.process.returncode:
        raise SystemExit(f"FAIL: the undisturbed run failed\n{text}")
    return open_dataset(attempt.target).content_hash, time.monotonic() - began


def torture(kills: int, seed: int, limit_s: float, size: float) -> dict[str, object]:
    random = np.random.Generator(np.random.PCG64(seed))
    counts: Counter[str] = Counter()
    entry = ENTRY.format(few=round(100 * size), many=round(200 * size))
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        calm, folder = Path(name) / "calm", Path(name) / "storm"
        for place in (calm, folder):
            place.mkdir()
            (place / "datasets.yaml").write_text(entry)
        wanted, duration = undisturbed(calm)
        print(f"undisturbed {duration:.1f} s  content {wanted[:12]}", flush=True)
        while counts["kills"] < kills and time.monotonic() - began < limit_s:
            attempt = Attempt(folder)
            until_pack = random.random() < 1 / 3
            wait_s = 10 * duration if until_pack else float(random.uniform(0, duration))
            if attempt.wait(wait_s, until_pack):
                if until_pack:
                    time.sleep(float(random.uniform(0, 0.03)))
                number = SIGNALS[random.integers(len(SIGNALS))]
                phase = attempt.phase()
                attempt.kill(number)
                counts.update(["kills", f"in {phase}", number.name])
            if attempt.target.exists():
                check(attempt.target, wanted)
                counts["finished files compared"] += 1
                attempt.target.unlink()
                (folder / "datasets.lock").unlink(missing_ok=True)
            if counts["kills"] % 10 == 0:
                print(f"{counts['kills']} kills  {dict(counts)}", flush=True)
        check_last(folder, wanted)
        counts["finished files compared"] += 1
    seconds = round(time.monotonic() - began)
    return {"seed": seed, "seconds": seconds, "content": wanted, **dict(sorted(counts.items()))}


def check_last(folder: Path, wanted: str) -> None:
    attempt = Attempt(folder)
    _, text = attempt.process.communicate()
    if attempt.process.returncode:
        raise SystemExit(f"FAIL: the last run cannot resume\n{text}")
    check(attempt.target, wanted)


def check(target: Path, wanted: str) -> None:
    try:
        found = open_dataset(target).content_hash
    except MpdtError as error:
        raise SystemExit(f"FAIL: a half-written file took the target's name\n{error}") from error
    if found != wanted:
        raise SystemExit(f"FAIL: content {found}, expected {wanted}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit-s", type=float, default=1800)
    parser.add_argument("--size", type=float, default=1, help="share of the episodes")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    result = torture(arguments.kills, arguments.seed, arguments.limit_s, arguments.size)
    print("PASS", json.dumps(result))
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
