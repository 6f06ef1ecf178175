"""How should X weigh the training tasks for an unseen class? Asked of classes left out.

    python experiments/held_out_classes.py FILE --cell ml45.MPDT-ones.s0 --run FOLDER
        [--leave-out 9 | NAME ...] [--draw 0] [--episodes 10] [--json F]

FILE's training tasks but those left out (drawn by --draw, or named) are trained on as the cell has
it; those left out are then judged behind prompts mixed in several ways. Unlike held_out_tasks.py,
where the map, the head and P_c have seen every task that is asked about, nothing has here: behind
a mean prompt a policy may know a training class by its first observation.
Test tasks are not touched.
"""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from trained import SEED
from trials import X_EPISODES, train_without

from mpdt.data.store.reader import open_dataset
from mpdt.draw.table import markdown_table
from mpdt.errors import MpdtError, UsageError
from mpdt.model.prompts import AdaptedPrompts
from mpdt.seeding import phase_seed
from mpdt.train.adapt.infer import explain, recognise
from mpdt.train.evaluate.controller import PromptController
from mpdt.train.evaluate.rollout import SimulatorCache, evaluate
from mpdt.train.fit.classifier import TaskClassifier, fit_task_classifier
from mpdt.train.fit.reward import (
    RewardModel,
    Transitions,
    fit_reward_model,
    read_training_tasks,
    read_transitions,
)

NEAREST = (1, 2, 4, 8)
LIKE = (1, 2, 4)
SHARES = (0.5, 0.75, 0.9)
TEMPERATURES = (0.05, 0.1, 0.2, 0.4)


def ways(
    model: RewardModel, classifier: TaskClassifier, x: Transitions
) -> dict[str, NDArray[np.float64]]:
    """Weights (N,) of the training tasks by name of the way."""
    explained = {most: explain(model, x, most) for most in NEAREST}
    two, errors = explained[2].weights, explained[2].errors
    mean = np.full(len(errors), 1 / len(errors))
    found = {"mean": mean, **{f"{most} nearest": one.weights for most, one in explained.items()}}
    for share in SHARES:
        found[f"2 nearest, {share:g} of the mean"] = (1 - share) * two + share * mean
    for temperature in TEMPERATURES:
        far = -(errors - errors.min()) / (temperature * x.rewards.std() + 1e-9)
        found[f"softmax at {temperature:g}"] = np.exp(far) / np.exp(far).sum()
    for most in (*LIKE, len(errors)):
        found[f"{most} most like its steps"] = recognise(classifier, x, most).weights
    return found


def main() -> None:
    args = parser_of(__doc__).parse_args()
    try:
        left_out = drawn(args.data, args.leave_out, args.draw)
        print("left out:", *left_out, flush=True)
        config, trained = train_without(args.data, args.cell, left_out, args.run)
        found = judge(config, trained, args.episodes)
    except MpdtError as error:
        sys.exit(error.render())
    rows = [[name, f"{np.mean(one['returns']):,.1f}", f"{np.mean(one['success']):.2f}"]
            for name, one in found.items()]  # fmt: skip
    print(markdown_table(["weights", "mean return", "success"], rows))
    if args.json:
        content = {"left_out": left_out, "episodes": args.episodes, "seed": SEED, "ways": found}
        args.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def parser_of(about: str) -> argparse.ArgumentParser:
    """What is trained on what, without which classes, and judged how long."""
    parser = argparse.ArgumentParser(description=about.splitlines()[0])
    parser.add_argument("data")
    parser.add_argument("--cell", required=True)
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--leave-out", nargs="+", default=["9"])
    parser.add_argument("--draw", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--json", type=Path)
    return parser


def drawn(data: str, words: list[str], draw: int) -> list[str]:
    """Names as they stand, or so many of the training tasks. Raises: UsageError for others."""
    dataset = open_dataset(data)
    names = [dataset.tasks.names[row] for row in dataset.tasks.train_rows]
    if not words[0].isdigit():
        if unknown := [word for word in words if word not in names]:
            raise UsageError("no training tasks", where="--leave-out", found=", ".join(unknown),
                             expected=", ".join(names))  # fmt: skip
        return words
    picked = np.random.default_rng(draw).choice(len(names), int(words[0]), replace=False)
    return [names[k] for k in sorted(picked.tolist())]


def judge(config: Any, trained: Any, episodes: int) -> dict[str, dict[str, list[float]]]:
    """Per way the mean return and the share of successes of every task left out."""
    material, family = trained.material, trained.material.family
    dataset, box = material.dataset, (family.action_low, family.action_high)
    known, seed = read_training_tasks(material), phase_seed(config.seed, "adapt")
    model = fit_reward_model(known, config.adapt.infer, seed)
    classifier = fit_task_classifier(known, config.adapt.infer, seed)
    tasks = material.tasks(material.test_rows)
    mixed: dict[str, list[NDArray[np.float64]]] = {}
    for row in material.test_rows:
        ids = dataset.select(task=row, quality="random")[:X_EPISODES]
        x = read_transitions(dataset, ids, dataset.steps.rewards, *box)
        for name, weights in ways(model, classifier, x).items():
            mixed.setdefault(name, []).append(weights)
    returns = trained.returns.pooled([family.return_target] * len(tasks))
    found, cache = {}, SimulatorCache()
    for name, rows in mixed.items():
        stacked = torch.from_numpy(np.stack(rows)).float()
        prompts = AdaptedPrompts(trained.prompts, "infer", len(tasks), stacked)
        actor = PromptController(trained.policy, prompts.task_prompts().detach(), returns,
                                 config.sampler.window, *box)  # fmt: skip
        result = evaluate(
            actor, family, tasks, material.options, config.evaluation.horizon or material.horizon,
            episodes, SEED, config.evaluation.max_rows, None, cache.make,
            partial(material.goal_key, block="train"),
        )  # fmt: skip
        found[name] = {"returns": result.returns.mean(axis=1).round(1).tolist(),
                       "success": [] if result.successes is None
                       else result.successes.mean(axis=1).tolist()}  # fmt: skip
        print(name, found[name], flush=True)
    return found


if __name__ == "__main__":
    main()
