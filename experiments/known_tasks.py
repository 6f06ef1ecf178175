"""Are tasks that were trained on told apart, and how many should share the weight?

    python experiments/known_tasks.py FILE [--run RUN] [--by rewards steps] [--tasks 1 2]
        [--episodes 3] [--json F]

Asked of training tasks: a model is fitted on every other random episode of each, the others are
then explained by it, the task itself among the candidates. With a trained RUN, whose settings
count, the mixtures that come out act: for mt10 and mt50, on training goals. Nothing held out is
touched.
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
from mpdt.train.adapt.infer import InferSettings, explain, recognise
from mpdt.train.fit.classifier import fit_task_classifier
from mpdt.train.fit.data import Material, load_material
from mpdt.train.fit.reward import fit_reward_model, read_transitions

COLUMNS = {"own_weight": ".2f", "own_most": ".0%", "mean_return": ",.1f", "success": ".1%"}


def told(
    material: Material, infer: InferSettings, seed: int, ways: list[str], most: list[int]
) -> dict[str, NDArray[np.float64]]:
    """Per way and number of tasks the weights (N, N), a row for each task that is asked."""
    dataset, family = material.dataset, material.family
    fitted, asked = (
        [read_transitions(dataset, dataset.select(task=row, quality="random")[half::2],
                          dataset.steps.rewards, family.action_low, family.action_high)
         for row in material.train_rows]
        for half in (0, 1)
    )  # fmt: skip
    found = {}
    if "rewards" in ways:
        model = fit_reward_model(fitted, infer, seed)
        found |= {f"rewards, {n}": [explain(model, x, n) for x in asked] for n in most}
    if "steps" in ways:
        classifier = fit_task_classifier(fitted, infer, seed)
        found |= {f"steps, {n}": [recognise(classifier, x, n) for x in asked] for n in most}
    return {name: np.stack([one.weights for one in own]) for name, own in found.items()}


def facts(weights: NDArray[np.float64]) -> dict[str, float]:
    """What the own task weighs, and how often it weighs most."""
    most = weights.argmax(axis=1) == np.arange(len(weights))
    return {"own_weight": float(weights.diagonal().mean()), "own_most": float(most.mean())}


def judged(
    run: Path, data: str, ways: list[str], most: list[int], episodes: int
) -> dict[str, dict[str, float]]:
    """The same with what the mixtures earn."""
    config, trained = open_run(run, data)
    seed = phase_seed(config.seed, "adapt")
    weights = told(trained.material, config.adapt.infer, seed, ways, most)
    mixtures = {name: torch.from_numpy(own).float() for name, own in weights.items()}
    return {
        name: facts(weights[name]) | {
            "mean_return": float(acted.returns.mean()),
            "success": float("nan") if acted.successes is None else float(acted.successes.mean()),
        }
        for name, acted in judged_behind(config, trained, mixtures, episodes)
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data")
    parser.add_argument("--run", type=Path)
    parser.add_argument("--by", nargs="+", default=["rewards", "steps"])
    parser.add_argument("--tasks", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--episodes", type=int, default=3)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    torch.set_num_threads(1)
    try:
        if args.run:
            found = judged(args.run, args.data, args.by, args.tasks, args.episodes)
        else:
            material, seed = load_material(args.data, "auto"), phase_seed(0, "adapt")
            weights = told(material, InferSettings(), seed, args.by, args.tasks)
            found = {name: facts(own) for name, own in weights.items()}
    except MpdtError as error:
        sys.exit(error.render())
    columns = [name for name in COLUMNS if name in next(iter(found.values()))]
    rows = [[name, *(format(one[column], COLUMNS[column]) for column in columns)]
            for name, one in found.items()]  # fmt: skip
    print(markdown_table(["by, tasks mixed", *columns], rows))
    if args.json:
        acted = {"run": args.run.name, "episodes": args.episodes, "seed": SEED} if args.run else {}
        content = {"data": Path(args.data).name, **acted, "asked": found}
        args.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
