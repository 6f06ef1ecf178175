"""Which inputs make a policy drive? One training run per variant, judged in the simulator.

    python experiments/closed_loop_study.py cheetah_dir.h5 [--steps 600] [--only NAME ...]

Every variant is the `demo` preset with one thing changed, trained without distillation, and
judged on training tasks alone, so nothing is selected on test tasks. Runs go to
`runs/study-<variant>` and are resumed or skipped when done. The table goes to stdout:
normalised return 0 = random, 1 = expert, mean over tasks and episodes.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from mpdt.draw.table import markdown_line, markdown_table

COLUMNS = ("variant", "action loss", "mean", "worst task", "s")
METHOD = "MPDT"
VARIANTS: dict[str, list[str]] = {
    "no-return": [],
    "return-family": ["--inputs.return-to-go", "family", "--inputs.no-return-clip"],
    "return-family-clip": ["--inputs.return-to-go", "family"],
    "return-task-clip": ["--inputs.return-to-go", "task"],
    "no-previous-action": ["--inputs.no-previous-action"],
    "no-time-table": ["--inputs.time-table", "0"],
    "no-start-windows": ["--sampler.start-bias", "0"],
    "frozen-map": ["--inputs.kind", "frozen"],
    "prompt-std-1": ["--prompts.init-std", "1.0"],
    "random-backbone": ["--backbone.name", "random:smollm2-135m"],
}


def run(
    data: Path, name: str, options: list[str], steps: int, threads: int, seed: int
) -> tuple[Path, float]:
    """Train and judge one variant; returns its folder and the wall time in seconds."""
    folder = f"study-{data.stem}-{name}-seed{seed}"
    command = [
        str(Path(sys.executable).parent / "mpdt-train"),
        *("--data", str(data), "--preset", "demo", "--name", folder),
        *("--seed", str(seed), "--threads", str(threads), "--teacher.distillation", "none"),
        *("--multitask.steps", str(steps), "--evaluation.no-constants"),
        # Seeds of its own: nothing may be chosen on those of the final tables.
        *("--evaluation.seed", "1000", "--evaluation.episodes", "5"),
        *("--adapt.starts", "none", "--quiet", *options),
    ]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    began = time.monotonic()
    done = subprocess.run(command, check=False, env=environment, stdout=subprocess.DEVNULL)
    if done.returncode:
        sys.exit(f"error: {name}: mpdt-train failed, as it says above")
    return Path("runs") / folder, time.monotonic() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", choices=sorted(VARIANTS), default=list(VARIANTS))
    args = parser.parse_args()
    print(markdown_table(COLUMNS, []), flush=True)
    for name in args.only:
        folder, seconds = run(args.data, name, VARIANTS[name], args.steps, args.threads, args.seed)
        print(markdown_line(row(name, folder, seconds)), flush=True)


def row(name: str, folder: Path, seconds: float) -> tuple[str, ...]:
    """What a finished run has for `COLUMNS`."""
    results = json.loads((folder / "results.json").read_text())
    losses = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    loss = [entry["action_loss"] for entry in losses if "action_loss" in entry][-1]
    scores = {
        score["task"]: score["normalised"]
        for score in results["scores"]
        if score["block"] == "train" and score["method"] == METHOD
    }
    worst = min((value, task) for task, value in scores.items() if task != "mean")
    return (name, f"{loss:.4f}", f"{scores['mean']:.2f}", f"{worst[0]:.2f} ({worst[1]})",
            f"{seconds:.0f}")  # fmt: skip


if __name__ == "__main__":
    main()
