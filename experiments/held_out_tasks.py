"""How many training tasks should share an unseen task? Asked of training tasks alone.

    python experiments/held_out_tasks.py RUN --data FILE [--tasks 1 2 3] [--episodes 1] [--json F]

Every training task in turn is explained by the others (decision 0010), from its random episodes
with rewards, and acts with their prompt: the nearest task's, or the mixture of the two nearest.
Test tasks are not touched, so `adapt.infer.tasks` may be chosen by this table. `own` is the task's
own prompt: what knowing the task exactly would earn. Episodes have a seed of their own.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from trained import SEED, judged_behind, open_run

from mpdt.draw.table import markdown_table
from mpdt.errors import MpdtError
from mpdt.seeding import phase_seed
from mpdt.train.adapt.infer import explain
from mpdt.train.evaluate.aggregate import mean, stratified_interval
from mpdt.train.fit.reward import fit_reward_model, read_training_tasks
from mpdt.train.run.progress import Progress


def returns_of(
    run: Path, data: str, most: list[int], episodes: int
) -> tuple[list[str], dict[str, NDArray[np.float64]]]:
    """Names of the training tasks (N); per way of acting, mean returns (N)."""
    config, trained = open_run(run, data)
    progress = Progress()
    known = read_training_tasks(trained.material)
    infer = config.adapt.infer
    model = fit_reward_model(
        known, infer, phase_seed(config.seed, "adapt"),
        lambda done, _: progress.update("reward model", done, infer.steps),
    )  # fmt: skip
    ways = {"own": torch.eye(len(known))}
    for tasks in most:
        rows = [explain(model, x, tasks, banned=[k]).weights for k, x in enumerate(known)]
        ways[f"{tasks} others"] = torch.from_numpy(np.stack(rows)).float()
    found = {}
    for name, judged in judged_behind(config, trained, ways, episodes):
        found[name] = judged.returns.mean(axis=1)
    return list(judged.tasks), found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--data", required=True)
    parser.add_argument("--tasks", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--episodes", type=int, default=1)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    try:
        tasks, found = returns_of(args.run, args.data, args.tasks, args.episodes)
    except MpdtError as error:
        sys.exit(error.render())
    rows = []
    for name, returns in found.items():
        # Tasks stand for the runs of one table column: they are what is resampled.
        low, high = stratified_interval(returns[:, None], mean)
        worst = int(returns.argmin())
        rows.append((name, f"{returns.mean():.1f}", f"[{low:.1f}, {high:.1f}]",
                     f"{tasks[worst]} {returns[worst]:.1f}"))  # fmt: skip
    print(markdown_table(("prompt of", "mean return", "95 % interval over tasks", "worst"), rows))
    if args.json:
        content = {
            "run": args.run.name,
            "tasks": tasks,
            "episodes": args.episodes,
            "seed": SEED,
            "returns": {name: own.round(2).tolist() for name, own in found.items()},
        }
        args.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
