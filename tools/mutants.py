"""A test of the tests: break the code in many places, one at a time, and see who notices.

    python tools/mutants.py [--only TEXT] [--jobs 2] [--json results/trust/mutants.json]

The breaks stand in mutants.toml: a file, a text in it, what takes its place, the tests that should
fail. Each is made in a copy of the tree and its tests are run until the first failure; a break that
they all pass survives, is listed, and asks for a better test (exit code 1). The same tests run
without a break first. `tests/tools/test_mutants.py` looks that every text is still there.

mutmut and cosmic-ray were considered: they change every operator of every line, thousands of
mutants of tests that take seconds, and cannot be told which break matters or who should notice.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import queue
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_name("mutants.toml")
LIMIT_S = 600
"""A break whose tests take longer hangs, which is noticed as well."""
FOLDERS = (
    "mpdt/train/fit", "mpdt/train/adapt", "mpdt/data/slices", "mpdt/data/store",
    "mpdt/data/verify", "mpdt/data/exchange",
)  # fmt: skip
"""Every file here should have a break."""
CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload([
    "torch", "transformers.models.gpt2.modeling_gpt2", "transformers.models.llama.modeling_llama",
    "h5py", "mujoco", "gymnasium", "pyarrow.parquet", "pytest",
])  # fmt: skip
NOTICED, SURVIVED, HANGS = "noticed", "survived", "hangs"


@dataclass(frozen=True)
class Break:
    """`old`, found once in `file`, becomes `new`; `tests` are files or ids, the likeliest first."""

    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def apply(self, tree: Path) -> str:
        """Break the file of a tree; returns its text of before. Raises: SystemExit."""
        path = tree / self.file
        before = path.read_text()
        if before.count(self.old) != 1:
            raise SystemExit(
                f"{self.file}: expected once, found {before.count(self.old)} times: {self.old!r}"
            )
        path.write_text(before.replace(self.old, self.new))
        return before


def read_list(path: Path = LIST) -> list[Break]:
    """Every break, in the order of the list."""
    breaks = tomllib.loads(path.read_text())["break"]
    return [Break(one["file"], one["old"], one["new"], tuple(one["tests"])) for one in breaks]


def files_without(breaks: list[Break]) -> list[str]:
    """Files of FOLDERS that hold code and that no break touches."""
    broken = {one.file for one in breaks}
    found = [p for folder in FOLDERS for p in sorted((ROOT / folder).glob("*.py"))]
    names = [str(p.relative_to(ROOT)) for p in found if p.stat().st_size]
    return [name for name in names if name not in broken]


def copy_tree(target: Path) -> Path:
    """What git knows, as it lies in the working tree; results are not needed by any of these."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    for name in filter(None, listed.split("\0")):
        source = ROOT / name
        if source.is_file() and not name.startswith("results/"):
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, target / name)
    return target


def run_tests(tree: Path, tests: Sequence[str]) -> tuple[int | None, str]:
    """pytest's exit code and output; None after LIMIT_S.

    In a process forked off one that has the large libraries: importing them anew takes longer than
    most tests.
    """
    with tempfile.NamedTemporaryFile("r") as output:
        child = CONTEXT.Process(target=_pytest, args=(str(tree), [*tests], output.name))
        child.start()
        child.join(LIMIT_S)
        if child.is_alive():
            child.kill()
            child.join()
            return None, ""
        return child.exitcode, output.read()


def _pytest(tree: str, tests: list[str], output: str) -> None:
    """In the child. Keeps no bytecode: a break may leave a file's size and second as they were."""
    os.chdir(tree)
    sys.path.insert(0, tree)
    sys.dont_write_bytecode = True
    os.environ |= {"PYTHONPATH": tree, "PYTHONDONTWRITEBYTECODE": "1"}
    with Path(output).open("w") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
        import pytest

        options = [
            "-x",
            "-p",
            "no:cacheprovider",
            "--tb=no",
            "-rfE",
            "-W",
            "ignore::pytest.PytestAssertRewriteWarning",
        ]  # plugins are loaded already
        code = int(pytest.main([*options, *tests]))
        sys.stdout.flush()
        os._exit(code)


def try_break(one: Break, tree: Path) -> dict[str, Any]:
    """Break, test, mend. Raises: SystemExit for a break that tests nothing."""
    began = time.monotonic()
    before = one.apply(tree)
    try:
        code, text = run_tests(tree, one.tests)
    finally:
        (tree / one.file).write_text(before)
    by = re.search(r"^(?:FAILED|ERROR) (\S+)", text, re.MULTILINE)
    if code not in (None, 0, 1) or (code == 1 and by is None):
        raise SystemExit(f"{one.file}: pytest ended with {code}: {one.new!r}\n{text[-2000:]}")
    outcome = HANGS if code is None else NOTICED if code else SURVIVED
    return {
        "file": one.file, "old": one.old, "new": one.new, "outcome": outcome,
        "by": by[1].partition("[")[0] if by else "",
        "seconds": round(time.monotonic() - began, 1),
    }  # fmt: skip


def check_unbroken(breaks: list[Break]) -> None:
    """Raises: SystemExit if a test of these breaks fails without any."""
    tests = dict.fromkeys(test for one in breaks for test in one.tests)
    with tempfile.TemporaryDirectory() as name:
        code, text = run_tests(copy_tree(Path(name)), list(tests))
    if code != 0:
        raise SystemExit(f"the tests fail without a break: {code}\n{text[-3000:]}")


def try_all(breaks: list[Break], jobs: int) -> list[dict[str, Any]]:
    """What became of each, in the order of the list."""
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(jobs) as pool:
        trees: queue.SimpleQueue[Path] = queue.SimpleQueue()
        for number in range(jobs):
            trees.put(copy_tree(Path(name) / str(number)))

        def attempt(one: Break) -> dict[str, Any]:
            tree = trees.get()
            try:
                return try_break(one, tree)
            finally:
                trees.put(tree)

        found = []
        for result in pool.map(attempt, breaks):
            print(f"{result['outcome']:<9} {result['file']}  {result['by']}", flush=True)
            found.append(result)
        return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="", help="breaks of files with this in their name")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    breaks = read_list()
    chosen = [one for one in breaks if options.only in one.file]
    if not chosen:
        parser.error(f"no break in a file with {options.only!r} in its name")
    began = time.monotonic()
    check_unbroken(chosen)
    found = try_all(chosen, options.jobs)
    survivors = [one for one in found if one["outcome"] == SURVIVED]
    report = {
        "seconds": round(time.monotonic() - began), "breaks": found,
        "files without": files_without(breaks),
    }  # fmt: skip
    if options.json:
        options.json.write_text(json.dumps(report, indent=1) + "\n")
    print(f"{len(found)} breaks, {len(survivors)} survived, {report['seconds']} s")
    for one in survivors:
        print(f"  {one['file']}\n    - {one['old']}\n    + {one['new']}")
    print("files without a break:", ", ".join(report["files without"]) or "none")
    sys.exit(bool(survivors))


if __name__ == "__main__":
    main()
