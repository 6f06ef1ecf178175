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
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any

import numpy as np

FAULTS = ("destroyed", "unkept", "both failed", "wrong", "left behind")
ENTRY = """schema: 1
datasets:
  tiny:
    version: "1.0.0"
    family: cheetah_dir
    horizon: 20
    seed: 5
    block: 4
    behaviour: {network: cheetah_dir, rungs: 5, noise: 0.1}
    episodes: {random: 4, medium: 4, expert: 4}
    tta: {default: {episodes: 2}}
    license: CC0-1.0
"""
TRAINING = (
    "--preset smoke --threads 1 --statistics.batches 1 --evaluation.horizon 3 -q "
    "--evaluation.no-constants --multitask.log-every 1 --teacher.steps 2 --multitask.steps 2 "
    "--adapt.starts cross"
)
# What a command may answer because of what another one left, beside BusyError.
REFUSALS = re.compile(
    "would replace|something else is there|the target exists|a folder is in the way|"
    "not a record of references|not a calibration file|not an HDF5 file|a folder, not a file|"
    "other episodes took their place meanwhile|the target was made|an HDF5 file, but not one|"
    "this folder holds files but no run|a file is in the way|was cut out of another file"
)


UNFINISHED = re.compile(r"t\.h5(\.tta-n\d+)?\.parts?(\.json)?$")
PUSHED = re.compile(r"[em]\.h5(\.sha256)?$")


@dataclass(frozen=True)
class Command:
    """One way to write a target.

    Args:
        words: as typed, with T for the target, N for a name of its own, S for the sources.
        start: "absent", or "dataset" for what adds to a file.
        replaces: whatever is at the target, because it was asked to.
        result: what of the target is its result, given the name; equal to that of a calm run.
        share: of the pairs that come up, how many are run; training takes seconds.
    """

    words: str
    result: Callable[[Path, str], Any]
    start: str = "absent"
    replaces: bool = False
    share: float = 1.0


def content(path: Path, name: str) -> Any:
    from mpdt.data.store.reader import open_dataset

    return open_dataset(path).content_hash


def pushed(sent: str) -> Callable[[Path, str], Any]:
    """A folder that is there already gets the file inside."""
    return lambda path, name: content(path / sent if path.is_dir() else path, name)


def text_of(path: Path, name: str) -> Any:
    """First and last line and the number of lines; what is between holds times."""
    lines = path.read_text().splitlines()
    return lines[0], lines[-1], len(lines)


def tree_of(path: Path, name: str) -> Any:
    """Names in a folder."""
    if not path.is_dir():
        raise ValueError("no folder")
    names = {str(p.relative_to(path)) for p in path.rglob("*")}
    return sorted(name for name in names if not PUSHED.match(name))


def has_slice(path: Path, name: str) -> Any:
    from mpdt.data.store.reader import open_dataset

    return len(open_dataset(path).slices[name])


def has_set(path: Path, name: str) -> Any:
    from mpdt.data.store.reader import open_dataset

    return len(open_dataset(path).tta[name])


def entries(path: Path, name: str) -> Any:
    return sorted((e["scene"], e["horizon"]) for e in json.loads(path.read_text())["entries"])


def run_of(path: Path, name: str) -> Any:
    results = json.loads((path / "results.json").read_text())
    names = sorted(p.name for p in path.iterdir() if not PUSHED.match(p.name))
    return names, results["identity"], len(results["scores"])


COMMANDS = {
    "split": Command("split S/cd.h5 --quality expert -o T", content),
    "split --name": Command("split T --episodes 1 --name N", has_slice, start="dataset"),
    "tta": Command("tta T --name N --episodes 1 --horizon 4 --workers 0", has_set,
                   start="dataset"),
    "merge": Command("merge S/m.h5 S/e.h5 -o T", content),
    "drop": Command("drop S/cd.h5 --episodes 0 -o T", content),
    "collect": Command("collect tiny --workers 0 -o T --spec S/datasets.yaml", content),
    "import": Command("import S/npz --from npz -o T", content),
    "export": Command("export S/cd.h5 --to npz -o T", tree_of),
    "export parquet": Command("export S/cd.h5 --to parquet -o T", tree_of),
    "pull": Command("pull S/m.h5 -o T", content),
    "pull of a folder": Command("pull S/sent -o T", tree_of),
    "push": Command("push S/m.h5 T", pushed("m.h5")),
    "push --replace": Command("push S/e.h5 T --replace", pushed("e.h5"), replaces=True),
    "report": Command("report S/cd.h5 --film none --no-verify -o T", text_of, replaces=True),
    "verify --markdown": Command("verify S/cd.h5 --only hash --markdown T", text_of,
                                 replaces=True),
    "reference": Command("reference tiny --policies zero --most 20 --workers 0 -o T "
                         "--spec S/datasets.yaml", entries),
    "training": Command("TRAIN --data S/cd.h5 --runs-dir T/.. --name t.h5 QUICK", run_of,
                        share=0.1),
    "page of a run": Command("TRAIN report S/run --html T", text_of, replaces=True),
}  # fmt: skip


@dataclass
class Job:
    """A command on its way: a forked process, what it said, how it ended."""

    kind: str
    name: str
    pid: int
    said: Path
    signal: int = 0
    code: int = field(default=-1)

    @property
    def text(self) -> str:
        return self.said.read_text(errors="replace")

    def wait(self) -> None:
        self.code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])


@dataclass
class Stage:
    """A working folder with its sources, and what commands leave when nobody disturbs them."""

    sources: Path
    place: Path
    random: np.random.Generator
    calm: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    number: int = 0

    @property
    def target(self) -> Path:
        return self.place / "t.h5"

    def clear(self) -> None:
        """An empty folder, but for a user's own files of similar names."""
        shutil.rmtree(self.place, ignore_errors=True)
        self.place.mkdir()
        (self.place / "t.h5.tmp").mkdir()
        (self.place / "t.h5.tmp" / "notes").write_text("mine")
        (self.place / "mine").write_text("mine")
        (self.place / ".t.h5.tmp").symlink_to("mine")

    def own_files_stay(self) -> bool:
        link, notes = self.place / ".t.h5.tmp", self.place / "t.h5.tmp" / "notes"
        return (
            link.is_symlink() and link.read_text() == "mine" == notes.read_text()
            and (self.place / "mine").read_text() == "mine"
        )  # fmt: skip

    def left_behind(self, goes_on: bool) -> list[str]:
        """Names beside the target that are nobody's result.

        Args:
            goes_on: a command did not get through, so what it has so far may stay.
        """
        known = {"t.h5", "t.h5.tmp", "mine", ".t.h5.tmp", "t.h5.sha256"}
        names = {path.name for path in self.place.iterdir()} - known
        return sorted(name for name in names if not (goes_on and UNFINISHED.match(name)))

    def start(self, kind: str, delay_s: float = 0.0, name: str = "") -> Job:
        """Run a command in a fork of this process."""
        self.number += 1
        name, said = name or f"n{self.number}", self.sources.parent / f"said-{self.number}"
        words = [
            word.replace("T", str(self.target), 1) if word in ("T", "T/..") else
            name if word == "N" else word.replace("S/", f"{self.sources}/")
            for word in COMMANDS[kind].words.replace("QUICK", TRAINING).split()
        ]  # fmt: skip
        pid = os.fork()
        if pid == 0:
            code = 70
            try:
                _become(words, said, self.place)
                time.sleep(delay_s)
                code = _answer(words)
            except BaseException:  # noqa: BLE001  it is shown, and counted
                import traceback

                traceback.print_exc()
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(code)
        return Job(kind, name, pid, said)

    def measure(self, kind: str) -> None:
        """Run a command by itself, once: what it leaves, and how long it takes."""
        if kind in self.calm:
            return
        self.clear()
        if COMMANDS[kind].start == "dataset":
            shutil.copy(self.sources / "cd.h5", self.target)
        began = time.monotonic()
        job = self.start(kind)
        job.wait()
        self.seconds[kind] = time.monotonic() - began
        if job.code:
            raise SystemExit(f"FAIL: {kind} by itself\n{job.text}")
        self.calm[kind] = COMMANDS[kind].result(self.target, job.name)

    def holds(self, job: Job) -> bool:
        """Whether the target is, or contains, what this command leaves."""
        try:
            return bool(COMMANDS[job.kind].result(self.target, job.name) == self.calm[job.kind])
        except Exception:  # noqa: BLE001  whatever is there, it is not that
            return False


def _become(words: list[str], said: Path, place: Path) -> None:
    """In the fork: its own output, arguments and folder."""
    handle = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    os.chdir(place.parent)
    program = "mpdt-train" if words[0] == "TRAIN" else "mpdt-data"
    sys.argv = [program, *words]


def _answer(words: list[str]) -> int:
    if words[0] != "TRAIN":
        from mpdt.data.cli import main

        return main(words)
    from mpdt.train.cli import main as train

    try:
        train(words[1:])
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def prepare(folder: Path, random: np.random.Generator, training: bool) -> Stage:
    """A stage with its sources."""
    stage = Stage(folder / "sources", folder / "place", random)
    stage.sources.mkdir()
    (stage.sources / "datasets.yaml").write_text(ENTRY)
    stage.place.mkdir()
    here = f"{stage.sources}/"
    texts = [
        f"collect tiny --workers 0 -o {here}cd.h5 --spec {here}datasets.yaml",
        f"split {here}cd.h5 --quality medium -o {here}m.h5",
        f"split {here}cd.h5 --quality expert -o {here}e.h5",
        f"export {here}cd.h5 --to npz -o {here}npz",
        f"push {here}npz {here}sent",
        f"TRAIN --data {here}cd.h5 --runs-dir {stage.sources} --name run {TRAINING}",
    ]
    for text in texts[: None if training else -1]:
        pid = os.fork()
        if pid == 0:
            _become(text.split(), folder / "said", stage.place)
            os._exit(_answer(text.split()))
        if os.waitpid(pid, 0)[1]:
            raise SystemExit(f"FAIL: {text}\n{(folder / 'said').read_text()}")
    (stage.sources / "datasets.lock").unlink(missing_ok=True)
    return stage


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
