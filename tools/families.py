"""Collect the datasets of all families, and write docs/datasets.md and docs/cards from them.

    python tools/families.py FOLDER [NAME ...]            collect what is missing, then write
    python tools/families.py FOLDER --write               write from the files that are there

Minutes are wall-clock time of `mpdt-data collect NAME` with two workers, kept beside the file
because a file holds no times. An interrupted collection goes on; its minutes then count from the
start of the last attempt and are marked.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from mpdt.data.reference import level
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset
from mpdt.draw.table import markdown_table

FAMILIES = ("cheetah_dir", "cheetah_vel", "ant_dir", "ml10", "ml45", "mt10", "mt50")
PAGE = Path(__file__).parent.parent / "docs" / "datasets.md"
CARDS = PAGE.parent / "cards"
QUALITIES = ("random", "medium", "expert", "history")
HEADING = ("dataset", "tasks", "episodes", "steps", "MB", "minutes")


def collect(name: str, folder: Path) -> None:
    """Make FOLDER/NAME.h5 unless it is there, and note how long that took."""
    target = folder / f"{name}.h5"
    if target.exists():
        return
    resumed = Path(f"{target}.parts").is_dir()
    command = [sys.executable, "-m", "mpdt.data.cli", "collect", name, "-o", str(target)]
    began = time.monotonic()
    subprocess.run([*command, "--workers", "2"], check=True)
    note = {"minutes": (time.monotonic() - began) / 60, "resumed": resumed, "cpu": cpu_name()}
    note_path(target).write_text(json.dumps(note) + "\n")


def write_card(file: Path) -> None:
    """docs/cards/NAME.html, the page that the file writes about itself: a minute for its checks."""
    target = CARDS / f"{file.stem}.html"
    command = [sys.executable, "-m", "mpdt.data.cli", "report", file.name, "-o", str(target)]
    # In its folder, or what verify advises would name a path of this machine.
    subprocess.run([*command, "--quiet"], check=True, cwd=file.parent)


def note_path(target: Path) -> Path:
    return target.with_suffix(".time.json")


def cpu_name() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next(line.split(": ")[1] for line in lines if line.startswith("model name"))


def per_quality(data: Dataset, row: int | None, success: bool) -> list[str]:
    """Mean return of each quality, over all tasks or one; success rates instead if asked."""
    cells = []
    for quality in QUALITIES:
        ids = data.select(task=row, quality=quality)
        values = data.episodes.success if success else data.episodes.returns
        cells.append(f"{values[ids].mean():,.2f}" if len(ids) else "-")
    return cells


def family_row(data: Dataset, note: dict[str, Any]) -> list[str]:
    tta = sum(len(found) for found in data.tta.values())
    minutes = f"{note['minutes']:.1f}{'*' if note['resumed'] else ''}" if note else "-"
    size = data.path.stat().st_size / 1e6
    has_success = data.steps.successes is not None
    return [
        f"`{data.name}` {data.version}",
        str(len(data.tasks)),
        f"{data.num_episodes:,} + {tta:,}",
        f"{data.num_steps:,}",
        f"{size:,.0f}",
        minutes,
        *per_quality(data, None, success=False),
        " / ".join(per_quality(data, None, success=True)[:3]) if has_success else "-",
        f"`{data.content_hash[:12]}`",
    ]


def task_rows(data: Dataset) -> list[list[str]]:
    roles = {0: "train", 1: "test", 2: "both"}
    tasks, rows = data.tasks, []
    for row, name in enumerate(tasks.names):
        low, high = float(tasks.ref_random[row]), float(tasks.ref_expert[row])
        medium = data.select(task=row, quality="medium")
        reached = level(float(data.episodes.returns[medium].mean()), low, high)
        cells = [name, roles[int(tasks.roles[row])]]
        for policy in ("zero", "random", "constant", "expert"):
            found = tasks.references[row][policy]
            known = not np.isnan(found.mean)
            cells.append(f"{found.mean:,.1f} ± {found.error:,.1f}" if known else "-")
        cells += [*per_quality(data, row, success=False), f"{reached:.2f}"]
        if data.steps.successes is not None:
            cells.append(" / ".join(per_quality(data, row, success=True)[:3]))
        rows.append(cells)
    return rows


def write(folder: Path) -> None:
    paths = [path for name in FAMILIES if (path := folder / f"{name}.h5").exists()]
    datas = [open_dataset(path) for path in paths]
    notes = [json.loads(p.read_text()) if (p := note_path(path)).exists() else {} for path in paths]
    machines = sorted({note["cpu"] for note in notes if note})
    text = [
        "# The datasets\n",
        "Written by `python tools/families.py FOLDER` from the files it collected; do not edit.\n",
        "Returns are means over tasks and episodes in each task's own reward; episodes are "
        "stored + test-time adaptation; minutes are wall-clock on two cores "
        f"({', '.join(machines) or 'not measured'}; * = resumed, last attempt only).\n",
        markdown_table(
            [*HEADING, *QUALITIES, "success r / m / e", "content"],
            [family_row(data, note) for data, note in zip(datas, notes, strict=True)],
        ),
        "\nPer task: reference returns ± standard error (zero action, uniform actions, best "
        "task-blind constant action, expert), mean return of the stored episodes per quality, and "
        "`level`, the normalised return of medium, which must lie in [0.35, 0.65].",
    ]
    for data in datas:
        heading = ["task", "role", "zero", "random ref", "constant", "expert ref"]
        heading += [*QUALITIES, "level"]
        if data.steps.successes is not None:
            heading.append("success r / m / e")
        text += [f"\n## {data.name}\n", markdown_table(heading, task_rows(data))]
    PAGE.write_text("\n".join(text) + "\n")
    CARDS.mkdir(exist_ok=True)
    for path in paths:
        write_card(path)
    print(f"written  {PAGE}  {len(datas)} datasets")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", metavar="NAME", help="default: all seven families")
    parser.add_argument("--write", action="store_true", help="collect nothing")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for name in [] if arguments.write else arguments.names or FAMILIES:
        collect(name, arguments.folder)
    write(arguments.folder)


if __name__ == "__main__":
    main()
