"""Small inputs that announce much: what the command line spends on them before it says no.

    python benchmarks/trust/limits.py [--only WORD] [--forked] [--json FILE]

Every input is written here, given to the command a user would type, in a process of its own, and
its most memory and time are taken. Exit code 1 if one is read as good although it is not, ends
with a traceback, takes more than `MOST_MB` or `MOST_S`. `a plain file` is what the command takes
for an input that is as small as it looks. --forked: processes are forks of this one, which saves
their imports and counts its memory as theirs, the largest inputs are an eighth, and so is
`MOST_MB` beside that; it is what `make test` does.
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
from collections.abc import Callable
from pathlib import Path
from typing import Any

import forks
import small_inputs
from small_inputs import ENTRY, INPUTS, Input

Run = Callable[[tuple[str, ...]], tuple[int, str, float, float]]
MOST_MB, MOST_S = 1000, 10.0
OWN_MB = 120
"""Of a fork: what it has of its parent."""
NO_END_S = 60.0


# Its own most memory: what the system counts for a child begins with that of its parent.
CHILD = """
import sys
from mpdt.data.cli import main
try:
    code = main(sys.argv[1:])
finally:
    lines = open("/proc/self/status").read().splitlines()
    print("peak", next(line.split()[1] for line in lines if line.startswith("VmHWM")))
sys.exit(code)
"""


def run(words: tuple[str, ...]) -> tuple[int, str, float, float]:
    """Exit code, stderr, most memory in MB and seconds of `mpdt-data WORDS`."""
    began = time.monotonic()
    command = [sys.executable, "-c", CHILD, *words]
    try:
        done = subprocess.run(
            command, capture_output=True, timeout=NO_END_S, check=False, text=True, errors="replace"
        )
    except subprocess.TimeoutExpired:
        return -signal.SIGKILL, "", 0.0, NO_END_S
    peak = done.stdout.rpartition("peak ")[2].strip()
    seconds = time.monotonic() - began
    return done.returncode, done.stderr, int(peak or 0) / 1024, seconds


def run_forked(words: tuple[str, ...]) -> tuple[int, str, float, float]:
    """As `run`, by a fork that has every module already."""
    began, said = time.monotonic(), Path("said")
    pid = forks.start(words, said, Path.cwd(), limit_s=NO_END_S)
    _, status, used = os.wait4(pid, 0)
    text = said.read_text(errors="replace")
    said.unlink()
    seconds = time.monotonic() - began
    return os.waitstatus_to_exitcode(status), text, used.ru_maxrss / 1024, seconds


# ---- the run ----------------------------------------------------------------------------------


def originals(run: Run) -> None:
    """tiny.h5 and its exports, made with the project's own commands."""
    Path("datasets.yaml").write_text(ENTRY.replace("RANDOM", "2"))
    commands = [("collect", "tiny", "-q", "--workers", "0")]
    commands += [("export", "tiny.h5", "--to", to, "-o", to) for to in ("npz", "parquet", "minari")]
    for words in commands:
        code, said, _, _ = run(words)
        if code:
            raise SystemExit(f"{' '.join(words)}: {said}")
    Path("datasets.yaml").unlink()


def size_of(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(one.stat().st_size for one in files if one.is_file())


def look(one: Input, base: Path, run: Run, most: float) -> dict[str, Any]:
    """One input in a copy of the originals."""
    with tempfile.TemporaryDirectory(dir=base) as name:
        for made in ("tiny.h5", "npz", "parquet", "minari"):
            (Path(name) / made).symlink_to(base / made)
        os.chdir(name)
        path = one.make()
        size = size_of(path)
        words = tuple(str(path) if word == "IN" else word for word in one.words)
        code, said, megabytes, seconds = run(words)
        os.chdir(base)
    error = next((line for line in said.splitlines() if line.startswith("error")), "")
    faults = [] if code == one.code else [f"exit code {code}, not {one.code}"]
    faults += ["a traceback"] * ("Traceback" in said)
    faults += [f"{megabytes:.0f} MB"] * (megabytes > most)
    faults += ["no end"] * (code in (-signal.SIGKILL, -signal.SIGALRM)) or [f"{seconds:.1f} s"] * (
        seconds > MOST_S
    )
    return {"input": one.name, "command": one.words[0], "bytes": size, "code": code,
            "megabytes": round(megabytes), "seconds": round(seconds, 1), "faults": faults,
            "error": error.replace(str(path), path.name)[:160]}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="")
    parser.add_argument("--forked", action="store_true")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    target = None if arguments.json is None else arguments.json.resolve()
    rows, way, most = [], run, MOST_MB
    if arguments.forked:
        small_inputs.SHARE, way, most = 8, run_forked, OWN_MB + MOST_MB // 8
    with tempfile.TemporaryDirectory() as name:
        os.chdir(name)
        originals(way)
        for one in INPUTS:
            if arguments.only in f"{one.words[0]} {one.name}":
                rows.append(look(one, Path(name), way, most))
                print(json.dumps(rows[-1]), flush=True)
        os.chdir("/")
    if target is not None:
        target.write_text(json.dumps(rows, indent=1) + "\n")
    if wrong := [row for row in rows if row["faults"]]:
        raise SystemExit(f"FAIL: {len(wrong)} of {len(rows)}")


if __name__ == "__main__":
    main()
