"""Start-up of the command line, each time in a fresh process.

python benchmarks/speed/starting.py [--rounds 5] [--keep]
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import rounds

COMMANDS = {
    ("mpdt-data", "--help"): 0.3,
    ("mpdt-data", "list"): 0.5,
    ("mpdt-data", "collect", "--help"): None,
    ("mpdt-train", "--help"): None,
}
TOLD = """
import runpy, sys
sys.argv = {words!r}
try:
    runpy.run_module({module!r}, run_name="__main__")
except SystemExit:
    pass
sys.stderr.write("imports torch" if "torch" in sys.modules else "without torch")
"""


def measure(report: rounds.Report) -> None:
    folder = tempfile.mkdtemp(prefix="mpdt-bench-")
    scripts = Path(sys.executable).parent
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    for words, most in COMMANDS.items():
        times = []
        for _ in range(2 * report.rounds + 1):
            began = time.perf_counter()
            subprocess.run([scripts / words[0], *words[1:]], cwd=folder, check=True, **quiet)
            times.append(time.perf_counter() - began)
        module = "mpdt.data.cli" if words[0] == "mpdt-data" else "mpdt.train.cli"
        code = TOLD.format(words=list(words), module=module)
        said = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True,
                              text=True, check=False).stderr  # fmt: skip
        name = " ".join(words)
        report.fact(name, statistics.median(times[1:]), "s", most=most, note=said[-13:])
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", "pass"], check=True)
    report.fact("python itself", time.perf_counter() - began, "s")
    Path(folder).rmdir()


if __name__ == "__main__":
    rounds.main("starting", measure)
