"""How many training tasks should share the weight where the unseen goals are of tasks it knows?

    python experiments/known_tasks.py RUN --data FILE [--tasks 1 2] [--episodes 3]

For mt10 and mt50, asked of training goals: the reward model is fitted on every other random episode
of each task, the others are then explained by it, the task itself among the candidates, and the
mixtures that come out act on training goals. Held-out goals are not touched.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path

import numpy as np
import torch
from trained import SEED, open_run

from mpdt.draw.table import markdown_table
from mpdt.errors import MpdtError
from mpdt.seeding import phase_seed
from mpdt.train.adapt.candidates import Candidates
from mpdt.train.adapt.infer import explain
from mpdt.train.evaluate.rollout import SimulatorCache, evaluate
from mpdt.train.fit.reward import fit_reward_model, read_transitions
from mpdt.train.run.progress import Progress


def rows_of(run: Path, data: str, most: list[int], episodes: int) -> list[list[str]]:
    """Per number of tasks: weight of the own task, share of tasks where it is the largest, mean
    return, success."""
    config, trained = open_run(run, data)
    material, settings, progress = trained.material, config.evaluation, Progress()
    dataset, box = material.dataset, (material.family.action_low, material.family.action_high)
    fitted, asked = (
        [read_transitions(dataset, dataset.select(task=row, quality="random")[half::2],
                          dataset.steps.rewards, *box) for row in material.train_rows]
        for half in (0, 1)
    )  # fmt: skip
    model = fit_reward_model(fitted, config.adapt.infer, phase_seed(config.seed, "adapt"))
    with torch.no_grad():
        parts, cross = trained.prompts.task_parts(), trained.prompts.cross
    candidates, cache, rows = Candidates(trained, config), SimulatorCache(), []
    for tasks in most:
        weights = np.stack([explain(model, x, tasks).weights for x in asked])
        prompts = cross * torch.einsum("nk,kls->nls", torch.from_numpy(weights).float(), parts)
        judged = evaluate(
            candidates.controller(prompts, trained.returns), material.family,
            material.tasks(material.train_rows), material.options,
            settings.horizon or material.horizon, episodes, SEED, settings.max_rows,
            partial(progress.update, f"{tasks} tasks"), cache.make,
        )  # fmt: skip
        right = weights.argmax(axis=1) == np.arange(len(weights))
        success = "-" if judged.successes is None else f"{judged.successes.mean():.1%}"
        rows.append([str(tasks), f"{weights.diagonal().mean():.2f}", f"{right.mean():.0%}",
                     f"{judged.returns.mean():,.1f}", success])  # fmt: skip
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--data", required=True)
    parser.add_argument("--tasks", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--episodes", type=int, default=3)
    args = parser.parse_args()
    try:
        rows = rows_of(args.run, args.data, args.tasks, args.episodes)
    except MpdtError as error:
        sys.exit(error.render())
    columns = ["tasks mixed", "own weight", "own the largest", "mean return", "success"]
    print(markdown_table(columns, rows))


if __name__ == "__main__":
    main()
