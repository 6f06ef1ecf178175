"""What would each training task's prompt earn on each unseen task? The limit of choosing one.

    python experiments/transfer_matrix.py RUN --data FILE [--episodes 2] [--json FILE]

RUN is the folder of a trained run, FILE the data it was trained on. One row per training task, plus
`P_c` and `P_c o mean P_k` where prompts have these; one column per unseen task; mean return and
share of successes. The last line is the best row of every column: in hindsight, so no policy,
but no protocol that picks one prompt per task can earn more with these weights. Episodes have a
seed of their own (1000): nothing here may choose anything for the tables of results.
"""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from pathlib import Path

import numpy as np
import torch
from trained import SEED, open_run

from mpdt.draw.table import markdown_table
from mpdt.errors import MpdtError
from mpdt.train.adapt.candidates import Candidates
from mpdt.train.evaluate.rollout import Evaluation, SimulatorCache, evaluate
from mpdt.train.run.progress import Progress


def matrix(run: Path, data: str, episodes: int) -> tuple[list[str], Evaluation]:
    """Names of the prompts (M); returns and successes of M x n tasks, the tasks innermost."""
    config, trained = open_run(run, data)
    material, settings = trained.material, config.evaluation
    names = [material.dataset.tasks.names[row] for row in material.train_rows]
    with torch.no_grad():
        prompts = trained.prompts.task_prompts()
        cross, parts = trained.prompts.cross, trained.prompts.task_parts()
        if cross.shape == prompts.shape[1:] and parts.shape == prompts.shape:
            prompts = torch.cat([prompts, cross[None], (cross * parts.mean(dim=0))[None]])
            names += ["P_c", "P_c o mean P_k"]
    n = len(material.test_rows)
    candidates = Candidates(trained, config)
    controller = candidates.controller(
        prompts.repeat_interleave(n, dim=0),
        candidates.returns.select(torch.arange(n).repeat(len(prompts))),
    )
    found = evaluate(
        controller, material.family, material.tasks(material.test_rows) * len(prompts),
        material.options, settings.horizon or material.horizon, episodes, SEED, settings.max_rows,
        partial(Progress().update, "prompts"),
        SimulatorCache().make, partial(material.goal_key, block="test"),
    )  # fmt: skip
    return names, found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--data", required=True)
    parser.add_argument("--episodes", type=int, default=2)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    try:
        names, found = matrix(args.run, args.data, args.episodes)
    except MpdtError as error:
        sys.exit(error.render())
    tasks = list(dict.fromkeys(found.tasks))
    returns = found.returns.mean(axis=1).reshape(len(names), len(tasks))
    shares = np.full_like(returns, np.nan)
    if found.successes is not None:
        shares = found.successes.mean(axis=1).reshape(returns.shape)
    best = returns.argmax(axis=0)
    each = np.arange(len(tasks))
    lines = [*zip(names, returns, shares, strict=True),
             ("best in hindsight", returns[best, each], shares[best, each])]  # fmt: skip
    rows = [
        (name, *map(_cell, row, share), _cell(row.mean(), share.mean()))
        for name, row, share in lines
    ]
    print(markdown_table(("prompt of", *tasks, "mean"), rows))
    if args.json:
        prompts = {
            name: {"returns": row.round(1).tolist(), "successes": np.round(share, 3).tolist()}
            for name, row, share in lines
        }
        content = {"run": args.run.name, "tasks": tasks, "episodes": args.episodes, "seed": SEED}
        text = json.dumps(content | {"prompts": prompts}, indent=1)
        args.json.write_text(text + "\n", encoding="utf-8")


def _cell(value: float, share: float) -> str:
    return f"{value:.0f}" if np.isnan(share) else f"{value:.0f}, {share:.0%}"


if __name__ == "__main__":
    main()
