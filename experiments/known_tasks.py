"""How many training tasks should share the weight where the unseen goals are of tasks it knows?

    python experiments/known_tasks.py RUN --data FILE [--by rewards steps] [--tasks 1 2]
        [--episodes 3] [--json F]

For mt10 and mt50, asked of training goals: a model is fitted on every other random episode of each
task, the others are then explained by it, the task itself among the candidates, and the mixtures
that come out act on training goals. Held-out goals are not touched.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import msgspec
import numpy as np
import torch
from trained import SEED, judged_behind, open_run

from mpdt.draw.table import markdown_table
from mpdt.errors import MpdtError
from mpdt.seeding import phase_seed
from mpdt.train.adapt.infer import explain_all
from mpdt.train.fit.reward import read_transitions


def asked_of(
    run: Path, data: str, ways: list[str], most: list[int], episodes: int
) -> dict[str, dict[str, float]]:
    """Per way and number of tasks: what the own task weighs, how often most, return, success."""
    config, trained = open_run(run, data)
    material, dataset = trained.material, trained.material.dataset
    box = (material.family.action_low, material.family.action_high)
    fitted, asked = (
        [read_transitions(dataset, dataset.select(task=row, quality="random")[half::2],
                          dataset.steps.rewards, *box) for row in material.train_rows]
        for half in (0, 1)
    )  # fmt: skip
    weights = {}
    for by in ways:
        settings = msgspec.structs.replace(config.adapt.infer, by=by)
        for tasks in most:
            found = explain_all(fitted, asked, settings, tasks, phase_seed(config.seed, "adapt"))
            weights[f"{by}, {tasks}"] = np.stack([one.weights for one in found])
    mixtures = {name: torch.from_numpy(own).float() for name, own in weights.items()}
    return {
        name: {
            "own_weight": float(weights[name].diagonal().mean()),
            "own_most": float((weights[name].argmax(axis=1) == np.arange(len(asked))).mean()),
            "mean_return": float(judged.returns.mean()),
            "success": float("nan") if judged.successes is None else float(judged.successes.mean()),
        }
        for name, judged in judged_behind(config, trained, mixtures, episodes)
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--data", required=True)
    parser.add_argument("--by", nargs="+", default=["rewards", "steps"])
    parser.add_argument("--tasks", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--episodes", type=int, default=3)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    try:
        found = asked_of(args.run, args.data, args.by, args.tasks, args.episodes)
    except MpdtError as error:
        sys.exit(error.render())
    rows = [(name, f"{one['own_weight']:.2f}", f"{one['own_most']:.0%}",
             f"{one['mean_return']:,.1f}", f"{one['success']:.1%}")
            for name, one in found.items()]  # fmt: skip
    columns = ("by, tasks mixed", "own weight", "own the largest", "mean return", "success")
    print(markdown_table(columns, rows))
    if args.json:
        content = {"run": args.run.name, "episodes": args.episodes, "seed": SEED, "asked": found}
        args.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
