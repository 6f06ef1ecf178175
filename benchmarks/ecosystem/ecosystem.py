"""Exports of a dataset file, read by the packages they are made for.

    make ecosystem                                      a smoke version of cheetah_dir
    python benchmarks/ecosystem/ecosystem.py ml10.h5    any other file

The packages live in `build/ecosystem`, an environment of their own that borrows torch and numpy
from this one. Each check is a small program of `benchmarks/ecosystem/peers/`, which prints the
version and what it read. Writes results/ecosystem.json and docs/ecosystem.md; exit code 1 where
one failed.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from datetime import date
from pathlib import Path
from typing import Any

from mpdt.data.exchange.formats import FORMATS
from mpdt.data.store.reader import open_dataset
from mpdt.draw.table import markdown_table

ROOT = Path(__file__).parents[2]
HOME = ROOT / "build/ecosystem"
LOSSLESS = "TTA sets and named slices"
# Peer, the program that reads, the format, and what this peer does not carry beyond the format.
CHECKS = (
    ("Minari", "minari", "minari", ""),
    ("Minari", "minari", "minari-arrow", ""),
    ("TorchRL", "torchrl", "minari", "goal, seed key, policy and quality of an episode"),
    ("AgileRL", "agilerl", "minari", "goal, seed key, policy and quality of an episode"),
    ("Hugging Face datasets", "datasets", "parquet",
     "the last observation of an episode is in episodes.parquet, not among the rows"),
    ("duckdb", "duckdb", "parquet", ""),
    ("mlcroissant", "mlcroissant", "parquet", ""),
    ("LeRobot's LeRobotDataset", "lerobot", "lerobot", "images"),
    ("TorchRL", "torchrl_lerobot", "lerobot", ""),
    ("lerobot-doctor", "lerobot_doctor", "lerobot",
     "images; it warns of that, of a constant column and of tasks that differ"),
    ("pandas", "pandas", "lerobot", ""),
    ("OGBench", "ogbench", "ogbench", ""),
    ("d3rlpy", "d3rlpy", "d4rl", "goals; the last step of each episode that ran out of time"),
    ("Prompt-DT's layout", "promptdt", "promptdt", ""),
    ("NumPy", "numpy", "npz", ""),
)  # fmt: skip
PAGE = """# Read by others

Written by `make ecosystem`; do not edit. Each line is a program of `benchmarks/ecosystem/peers/`
that imports nothing of mpdt (Minari alone does, to recover the environment) and asserts what it
read: numbers of steps and episodes, returns, a replayed episode, a loss that falls. Data: {file},
content `{content_hash}`, {episodes:,} episodes, {steps:,} steps; read on {date}.

{table}

"Left out" is what the format or this reader has no place for. minari, minari-arrow, parquet and npz
are lossless: `mpdt-data import` gives the same content hash again, which `tests/data/exchange/`
checks.
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("file", type=Path, nargs="?", help="default: a smoke version, made now")
    parser.add_argument("--only", help="one peer; nothing is written then")
    options = parser.parse_args()
    python = environment()
    work = Path(tempfile.mkdtemp(prefix="ecosystem-"))
    try:
        file = options.file or smoke(work)
        chosen = [check for check in CHECKS if options.only in (None, check[0], check[1])]
        found = [run(python, work, file, *check) for check in chosen]
        if options.only is None:
            write(file, found)
    finally:
        shutil.rmtree(work)
    print(table(found))
    return 1 if any(not check["passed"] for check in found) else 0


def write(file: Path, checks: list[dict[str, Any]]) -> None:
    """The results and their page."""
    data = open_dataset(file)
    header = {
        "file": file.name, "content_hash": data.content_hash[:8], "episodes": data.num_episodes,
        "steps": data.num_steps, "date": date.today().isoformat(),
    }  # fmt: skip
    text = json.dumps(header | {"checks": checks}, indent=1) + "\n"
    (ROOT / "results/ecosystem.json").write_text(text)
    (ROOT / "docs/ecosystem.md").write_text(PAGE.format(table=table(checks), **header))


def environment() -> Path:
    """The interpreter with the packages; made on first use and after a change of the lists."""
    python = HOME / "bin/python"
    lists = [ROOT / f"benchmarks/ecosystem/packages{part}.txt" for part in ("", "-no-deps")]
    wanted = "".join(path.read_text() for path in lists)
    done = HOME / "installed.txt"
    if done.exists() and done.read_text() == wanted:
        return python
    subprocess.run([sys.executable, "-m", "venv", HOME], check=True)
    here = sysconfig.get_paths()["purelib"]
    site = subprocess.run(
        [python, "-c", "import sysconfig; print(sysconfig.get_paths()['purelib'])"],
        check=True, capture_output=True, text=True,
    ).stdout.strip()  # fmt: skip
    (Path(site) / "base.pth").write_text(f"import site; site.addsitedir({here!r})\n")
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "-c", ROOT / "constraints.txt", "-r", lists[0]], check=True)
    subprocess.run([*pip, "--no-deps", "-r", lists[1]], check=True)
    done.write_text(wanted)
    return python


def smoke(work: Path) -> Path:
    path = work / "cheetah_dir-smoke.h5"
    mpdt_data("collect", "cheetah_dir", "--smoke", "--workers", "0", "-o", path)
    return path


def mpdt_data(*words: object) -> None:
    command = [sys.executable, "-m", "mpdt.data.cli", *map(str, words), "-q"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def run(
    python: Path, work: Path, file: Path, peer: str, program: str, form: str, beyond: str
) -> dict[str, Any]:
    """One check: version, what was read or why not, and what stays behind."""
    folder = work / form
    if not folder.exists():
        mpdt_data("export", file, "--to", form, "-o", folder)
    script = ROOT / f"benchmarks/ecosystem/peers/read_{program}.py"
    words = [python, script, folder, work / "cache", open_dataset(file).num_steps]
    print(f"{peer} ...", file=sys.stderr)
    done = subprocess.run([*map(str, words)], capture_output=True, text=True, check=False)
    passed = done.returncode == 0
    lines = (done.stdout if passed else done.stderr).strip().splitlines() or ["no output"]
    version, _, text = lines[-1].partition(" ") if passed else ("", "", lines[-1])
    lost = "; ".join(part for part in (FORMATS[form].lost or LOSSLESS, beyond) if part)
    return {"peer": peer, "version": version, "format": form, "passed": passed, "read": text,
            "left_out": lost}  # fmt: skip


def table(checks: list[dict[str, Any]]) -> str:
    rows = [
        (one["peer"], one["version"], one["format"],
         one["read"] if one["passed"] else f"FAILED: {one['read']}", one["left_out"])
        for one in checks
    ]  # fmt: skip
    return markdown_table(("peer", "version", "format", "read", "left out"), rows, numbers=False)


if __name__ == "__main__":
    sys.exit(main())
