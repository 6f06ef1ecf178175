"""Run pairs of writing commands on one target, kill some; nothing may be lost or told wrongly.

    python benchmarks/trust/writers.py [--pairs 1000] [--seed 0] [--no-training] [--json FILE]

Every command that writes a file or folder meets itself and every other one, on a target that is
absent, an earlier result or a dataset. Both start at once, in forks of a process that has all
modules loaded; in a quarter of the pairs one is stopped after a random time, by SIGKILL or
SIGTERM, and given again afterwards. Half of the pairs run with HDF5_USE_FILE_LOCKING=FALSE. What
each command leaves when nobody disturbs it is measured first.

    destroyed     sources, a user's own files of similar names, or a target that is nobody's result
    unkept        a command that ended with 0 and whose result is not in the target, although no
                  later command was asked to replace it
    both failed   neither was killed, and neither succeeded
    wrong         a traceback, an error that does not say what is the matter, or a BusyError that
                  names nobody
    left behind   temporary files or locks, once the last command of the pair has ended
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import pkgutil
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any

import numpy as np
from writing_commands import COMMANDS
from writing_stage import Job, Stage, prepare

FAULTS = ("destroyed", "unkept", "both failed", "wrong", "left behind")
# What a command may answer because of what another one left, beside BusyError.
REFUSALS = re.compile(
    "would replace|something else is there|the target exists|a folder is in the way|"
    "not a record of references|not a calibration file|not an HDF5 file|a folder, not a file|"
    "other episodes took their place meanwhile|the target was made|an HDF5 file, but not one|"
    "this folder holds files but no run|a file is in the way|was cut out of another file"
)


def run_pair(stage: Stage, one: str, two: str) -> tuple[list[str], list[str]]:
    """What was counted, and what to say about faults."""
    random, kinds = stage.random, (one, two)
    for kind in kinds:
        stage.measure(kind)
    stage.clear()
    before = {path: path.stat().st_mtime_ns for path in sorted(stage.sources.rglob("*"))}
    start = _set_up(stage, kinds)
    first = stage.target.read_bytes() if start != "absent" and stage.target.is_file() else b""
    longest = max(stage.seconds[kind] for kind in kinds)
    jobs = [stage.start(kind, float(random.uniform(0, 0.1 * longest))) for kind in kinds]
    counts = [f"from {start}"]
    if random.random() < 0.25:
        victim = jobs[int(random.integers(2))]
        time.sleep(float(random.uniform(0, 1.2 * longest)))
        victim.signal = int(random.choice([signal.SIGKILL, signal.SIGTERM]))
        os.kill(victim.pid, victim.signal)
        counts.append("killed")
    for job in jobs:
        job.wait()
    finished = list(jobs)
    if killed := next((job for job in jobs if job.signal and job.code != 0), None):
        again = stage.start(killed.kind, name=killed.name)
        again.wait()
        finished.append(again)
        counts.append("given again")
    counts += [f"exit {job.code}" for job in jobs]
    faults = list(_faults(stage, finished, first))
    if {path: path.stat().st_mtime_ns for path in sorted(stage.sources.rglob("*"))} != before:
        faults.append(("destroyed", "a source changed"))
    said = " | ".join(
        f"{j.kind} pid {j.pid} signal {j.signal} exit {j.code}: {j.text.strip()[-300:]}"
        for j in finished
    )
    text = [f"{fault}: {why}\n  {one} + {two}, from {start}: {said}" for fault, why in faults]
    for job in finished:
        job.said.unlink()
    return counts + [fault for fault, _ in faults], text


def _set_up(stage: Stage, kinds: tuple[str, str]) -> str:
    """What is at the target before; what adds to a file needs one."""
    if any(COMMANDS[kind].start == "dataset" for kind in kinds):
        shutil.copy(stage.sources / "cd.h5", stage.target)
        return "dataset"
    if stage.random.random() < 0.3 and "split" in kinds:
        shutil.copy(stage.sources / "e.h5", stage.target)
        return "an earlier result"
    return "absent"


def _faults(stage: Stage, jobs: list[Job], first: bytes) -> Iterator[tuple[str, str]]:
    """Everything that is not as it must be."""
    undisturbed = [job for job in jobs if not job.signal]
    kept = {job.pid: stage.holds(job) for job in jobs}
    good = [job for job in jobs if job.code == 0]
    is_first = bool(first) and stage.target.is_file() and stage.target.read_bytes() == first
    # A killed command may have been through, or not.
    if not is_first and not any(kept.values()) and (first or good or os.path.lexists(stage.target)):
        yield "destroyed", "the target is neither what it was nor anybody's result"
    if not stage.own_files_stay():
        yield "destroyed", "a user's own files"
    for job in good:
        replaced = [other for other in good if other is not job and COMMANDS[other.kind].replaces]
        if not kept[job.pid] and not any(kept[other.pid] for other in replaced):
            yield "unkept", job.kind
    if len(undisturbed) == len(jobs) and not good:
        yield "both failed", ""
    pids = {job.pid for job in jobs}
    for job in jobs:
        if why := _wrong(stage, job, pids):
            yield "wrong", why
    last = {job.name: job.code for job in jobs}
    if left := stage.left_behind(goes_on=any(last.values())):
        yield "left behind", str(left)


def _wrong(stage: Stage, job: Job, pids: set[int]) -> str:
    """Why what a command said is wrong, or nothing."""
    if job.code in (0, -job.signal):  # before it listened, SIGTERM ends it as SIGKILL does
        return ""
    if "Traceback" in job.text or job.code not in (1, 2, 4, 128 + signal.SIGTERM):
        return f"{job.kind} ended with {job.code}"
    if job.code == 143:
        return (
            "" if job.signal and ("interrupted" in job.text or "stopped by" in job.text) else "143"
        )
    named = re.search(r"process (\d+) on", job.text)
    if job.code == 4:
        is_named = named and int(named[1]) in pids - {job.pid}
        return "" if is_named or "meanwhile" in job.text else "busy, and no holder named"
    if not REFUSALS.search(job.text):
        return f"{job.kind}: an error of its own"
    return "" if os.path.lexists(stage.target) else f"{job.kind} refused for what is not there"


def worker(pairs: int, seed: int, training: bool) -> dict[str, Any]:
    """Run pairs in this process, which loads everything once."""
    import mpdt.data

    for module in pkgutil.walk_packages(mpdt.data.__path__, "mpdt.data."):
        if not re.search(r"pretrain|snapshots|checkpoint|vecenv|workers\.ray", module.name):
            importlib.import_module(module.name)
    if training:
        importlib.import_module("mpdt.train.run.pipeline")
    random = np.random.Generator(np.random.PCG64(seed))
    counts: Counter[str] = Counter()
    texts: list[str] = []
    with tempfile.TemporaryDirectory(prefix="writers-") as folder:
        stage = prepare(Path(folder), random, training)
        kinds = [kind for kind, one in COMMANDS.items() if training or "TRAIN" not in one.words]
        for one, two in _choose(random, kinds, pairs):
            found, said = run_pair(stage, one, two)
            counts.update(["pairs", *found, f"{one} with {two}"])
            texts += said
            for text in said:
                print(text, file=sys.stderr, flush=True)
    return {"counts": dict(counts), "faults": texts}


def _choose(random: np.random.Generator, kinds: list[str], pairs: int) -> Iterator[tuple[str, str]]:
    """All pairs in random order, again and again."""
    every = list(combinations_with_replacement(kinds, 2))
    done = 0
    while done < pairs:
        for row in random.permutation(len(every)):
            share = min(COMMANDS[kind].share for kind in every[row])
            if done < pairs and random.random() < share:
                done += 1
                yield every[row]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--no-training", action="store_true", help="leave mpdt-train out")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        found = worker(arguments.pairs, arguments.seed, not arguments.no_training)
        print(json.dumps(found))
        return
    began = time.monotonic()
    result: dict[str, Any] = {"seed": arguments.seed}
    total: Counter[str] = Counter()
    faults: list[str] = []
    # HDF5 reads the variable when it is loaded, so each half has a process of its own.
    for number, locking in enumerate(("TRUE", "FALSE")):
        half = (arguments.pairs + 1 - number) // 2
        command = [sys.executable, __file__, "--worker", "--pairs", str(half),
                   "--seed", str(2 * arguments.seed + number)]  # fmt: skip
        command += ["--no-training"] * arguments.no_training
        environment = os.environ | {
            "HDF5_USE_FILE_LOCKING": locking, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"
        }  # fmt: skip
        done = subprocess.run(
            command, env=environment, stdout=subprocess.PIPE, text=True, check=True
        )
        found = json.loads(done.stdout.splitlines()[-1])
        total.update(found["counts"])
        total[f"HDF5_USE_FILE_LOCKING={locking}"] += half
        faults += found["faults"]
    result |= {"seconds": round(time.monotonic() - began), "pairs": total.pop("pairs", 0)}
    result |= {key: total.pop(key, 0) for key in (*FAULTS, "killed", "given again")}
    result["met"] = {key: total.pop(key) for key in sorted(total) if " with " in key}
    result |= dict(sorted(total.items()))
    print("FAIL" if faults else "PASS", json.dumps({k: v for k, v in result.items() if k != "met"}))
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1) + "\n")
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main()
