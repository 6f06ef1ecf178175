"""Interleaved rounds: each way of doing the same work runs once per round.

    round 1   ours  limit  peer
    round 2   ours  limit  peer        ratios are taken inside a round, then their median:
    round 3   ours  limit  peer        a machine that is busy now and then is busy for all

Each script of this folder that stands for rows of docs/performance.md has `measure(report)` and
ends with `rounds.main(...)`, which starts it anew with one BLAS thread if it had more. It looks
first whether others use the machine, and again at the end: if they do, nothing is judged, and what
was measured goes to build/bench/ and not into the place of what an idle machine has shown.
"""

from __future__ import annotations

import argparse
import io
import json
import multiprocessing
import os
import platform
import statistics
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import machine
from machine import cores

from mpdt.version import installed

__all__ = ["cores"]  # for the scripts
ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "results" / "bench"
BUSY = ROOT / "build" / "bench"
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
PACKAGES = ("mpdt", "numpy", "h5py", "mujoco", "metaworld", "gymnasium", "minari", "torch",
            "transformers", "torchrl", "d3rlpy", "stable-baselines3", "jax")  # fmt: skip


@dataclass(frozen=True)
class Way:
    """One way of doing the work.

    Args:
        kind: ours; limit, what the hardware allows; peer, another package; plain, ours without
            what makes it fast.
        work: units done per call of `run`, which may return another number instead.
        warm: called once before the rounds, where `run` itself would take too long.
    """

    name: str
    kind: str
    run: Callable[[], float | None]
    work: float
    warm: Callable[[], object] | None = None


@dataclass(frozen=True)
class Target:
    """`ours` is to be at least `least` times `way`, on machines of the class `only`.

    Args:
        only: bfloat16, no bfloat16, or nothing for all of them.
    """

    way: str
    least: float
    only: str = ""


class Report:
    """The cases of one path, printed as they are measured and written as JSON."""

    def __init__(self, path: str, rounds: int, idle: bool = True) -> None:
        self.path, self.rounds, self.idle = path, rounds, idle
        self._has_bfloat16 = machine.has_bfloat16()
        self.cases: list[dict[str, Any]] = []
        self.facts: list[dict[str, Any]] = []

    def compare(
        self, name: str, unit: str, ways: Sequence[Way], targets: Sequence[Target] = (),
        rounds: int = 0, note: str = "",
    ) -> dict[str, float]:  # fmt: skip
        """Measure `ways`, the first of which is ours; returns the median ratio ours / way."""
        rates: dict[str, list[float]] = {way.name: [] for way in ways}
        for way in ways:
            (way.warm or way.run)()  # caches, allocators, lazy imports
        for _ in range(rounds or self.rounds):
            for way in ways:
                began = time.perf_counter()
                done = way.run()
                seconds = time.perf_counter() - began
                rates[way.name].append((way.work if done is None else done) / seconds)
        ours = rates[ways[0].name]
        ratios = {
            way.name: statistics.median(a / b for a, b in zip(ours, rates[way.name], strict=True))
            for way in ways
        }
        rows = [
            {"name": way.name, "kind": way.kind, "rate": statistics.median(rates[way.name]),
             "spread": (max(rates[way.name]) - min(rates[way.name]))
             / statistics.median(rates[way.name]),
             "ours_over_this": ratios[way.name]}
            for way in ways
        ]  # fmt: skip
        judged = [
            {**asdict(target), "measured": ratios[target.way],
             "met": ratios[target.way] >= target.least}
            for target in targets if self._holds_here(target.only)
        ]  # fmt: skip
        self.cases.append({"case": name, "unit": unit, "rounds": rounds or self.rounds,
                           "rows": rows, "targets": judged, "note": note})  # fmt: skip
        print(f"\n{name:48} {unit:>16}   ours is")
        for row in rows:
            print(f"  {row['kind']:6} {row['name']:40} {row['rate']:15,.5g}"
                  f"   {row['ours_over_this']:8.2f} x   spread {row['spread']:.0%}")  # fmt: skip
        for target in judged:
            self._say(f"{target['least']:g} x {target['way']}", f"{target['measured']:.2f}",
                      target["met"])  # fmt: skip
        return ratios

    def _holds_here(self, only: str) -> bool:
        return only in ("", "bfloat16" if self._has_bfloat16 else "no bfloat16")

    def _say(self, wanted: str, found: str, met: bool) -> None:
        said = "met" if met else "MISSED"
        print(f"  target {wanted:46} {found:>10}   {said if self.idle else 'not judged: busy'}")

    def fact(
        self, name: str, value: float, unit: str, least: float | None = None,
        most: float | None = None, note: str = "",
    ) -> None:  # fmt: skip
        """One number with its bound; neither bound: only stated."""
        met = None if least is None and most is None else (
            (least is None or value >= least) and (most is None or value <= most))  # fmt: skip
        self.facts.append({"fact": name, "value": value, "unit": unit, "least": least,
                           "most": most, "met": met, "note": note})  # fmt: skip
        print(f"\n{name:58} {value:,.4g} {unit}   {note}")
        if met is not None:
            bound = f"at least {least:g}" if least is not None else f"at most {most:g}"
            self._say(f"{bound} {unit}", f"{value:.3g}", met)

    def write(self, seconds: float, others: float | None) -> Path:
        """Args: others: share of the machine that others had."""
        record = {"path": self.path, "machine": machine.describe(), "versions": versions(),
                  "seconds": round(seconds, 1), "others": others, "judged": self.idle,
                  "cases": self.cases, "facts": self.facts}  # fmt: skip
        folder = RESULTS if self.idle else BUSY
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{self.path}.json"
        path.write_text(json.dumps(record, indent=1) + "\n")
        return path


def versions() -> dict[str, str]:
    return {"python": platform.python_version()} | installed(PACKAGES)


def scratch() -> Path:
    """Where large files may go: beside the results, on the disk that users would use."""
    folder = ROOT / "build"
    folder.mkdir(exist_ok=True)
    return folder


@contextmanager
def without_output() -> Iterator[None]:
    """Drop what other packages print and warn while they are set up."""
    nowhere = io.StringIO()
    with warnings.catch_warnings(), redirect_stdout(nowhere), redirect_stderr(nowhere):
        warnings.simplefilter("ignore")
        yield


def have(package: str) -> bool:
    """Whether a peer is installed; without it its rows are left out."""
    if installed([package]):
        return True
    print(f"({package} is not installed: left out)")
    return False


@contextmanager
def worker_processes(
    factory: Callable[[int], dict[str, Callable[[], Any]]], size: int
) -> Iterator[Any]:
    """`size` processes, each with the ways `factory(number)` made in it.

    Yields `together(name)`: a function that runs that way in all of them at once, waits for the
    last one, and returns what they returned.
    """
    from mpdt.data.workers.processes import WORKER_ENVIRONMENT

    os.environ.update(WORKER_ENVIRONMENT)
    context = multiprocessing.get_context("spawn")
    pipes, processes = [], []
    for number in range(size):
        ours, theirs = context.Pipe()
        process = context.Process(target=_member, args=(factory, number, theirs), daemon=True)
        process.start()
        theirs.close()
        pipes.append(ours)
        processes.append(process)

    def together(name: str) -> Callable[[], list[Any]]:
        def run() -> list[Any]:
            for pipe in pipes:
                pipe.send(name)
            try:
                return [pipe.recv() for pipe in pipes]
            except (EOFError, ConnectionError):
                raise SystemExit(f"error: a worker ended at '{name}', see above") from None

        return run

    try:
        yield together
    finally:
        for pipe in pipes:
            pipe.close()
        for process in processes:
            process.join(timeout=20)


def _member(factory: Callable[[int], dict[str, Callable[[], Any]]], number: int, pipe: Any) -> None:
    ways = factory(number)
    while True:
        try:
            pipe.send(ways[pipe.recv()]())
        except EOFError:
            return


def main(path: str, measure: Callable[[Report], None], sources: Sequence[str] = ("mpdt",)) -> None:
    """Command line of one script.

    Args:
        sources: what a result depends on beside the script; `--keep` skips a script whose JSON
            is newer than all of it.
    """
    script = Path(sys.argv[0]).resolve()
    if any(os.environ.get(name) != "1" for name in THREADS):
        os.environ.update(dict.fromkeys(THREADS, "1"))
        os.execv(sys.executable, [sys.executable, *sys.argv])  # before numpy reads them
    parser = argparse.ArgumentParser(description=path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--keep", action="store_true", help="skip if the JSON is fresh")
    options = parser.parse_args()
    files = [script, Path(__file__)]
    files += [file for source in sources for file in (ROOT / source).rglob("*.py")]
    result = RESULTS / f"{path}.json"
    newest = max(file.stat().st_mtime for file in files)
    if options.keep and result.exists() and result.stat().st_mtime > newest:
        print(f"kept  {result.relative_to(ROOT)}")
        return
    print(f"== {path}")
    report = Report(path, options.rounds, _is_idle(machine.others_now(), "before the first round"))
    watch, began = machine.Watch(), time.monotonic()
    measure(report)
    others = watch.others()
    report.idle &= _is_idle(others, "while it measured")
    written = report.write(time.monotonic() - began, others)
    print(f"\nwritten  {written.relative_to(ROOT)}   {time.monotonic() - began:.0f} s")


def _is_idle(others: float | None, when: str) -> bool:
    """Whether it may be judged; says so where not."""
    if others is None or others <= machine.MOST:
        return True
    print(f"\nnot judged: others used {others:.0%} of this machine {when}")
    print(f"(at most {machine.MOST:.0%}); the stored result stays, this one goes to build/bench/")
    return False
