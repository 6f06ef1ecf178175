"""Meta-World's scripts beside the experts that are used: return and success on equal goals.

    python experiments/experts.py [TASK ...] [--goals 30] [--workers 1] [--json FILE]

Without TASK: every task whose expert differs from Meta-World's script. Per task a row before
(the plain script) and after (mpdt/data/sim/scripts.py), on the same goals:

    return 500, 200   mean over goals of the reward summed over so many steps, +- standard error
    success           share of goals with success at any step, and at the last one

The goals (seeds from 70,000) take part in no calibration and no data set.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from mpdt.data.sim.metaworld import MetaworldEnv
from mpdt.data.sim.scripts import Expert, corrections_of
from mpdt.data.spec.tasks import get_family
from mpdt.data.workers.processes import map_blocks
from mpdt.draw.table import markdown_line, markdown_table

COLUMNS = ("task", "expert", "return 500", "return 200", "success", "at the last step")
HORIZON, SHORT = 500, 200  # steps
FIRST_GOAL = 70_000


@dataclass(frozen=True)
class Row:
    """Means over the goals of one expert of one task."""

    task: str
    expert: str
    goals: int
    return_500: float
    error_500: float
    return_200: float
    success: float
    success_last: float


def measure(env: MetaworldEnv, raw: bool, num_goals: int) -> Row:
    """Play one episode of 500 steps per goal."""
    expert = Expert(env.task_name, raw=raw)
    rewards = np.zeros((num_goals, HORIZON))
    successes = np.zeros((num_goals, HORIZON), dtype=np.bool_)
    for number in range(num_goals):
        observation = env.reset(env.draw(FIRST_GOAL + number))
        for step in range(HORIZON):
            (action,) = expert.act(observation[None]).astype(np.float32)
            observation, rewards[number, step], successes[number, step] = env.step(action)
    returns = rewards.sum(axis=1)
    return Row(
        task=env.task_name,
        expert="before" if raw else "after",
        goals=num_goals,
        return_500=round(float(returns.mean()), 1),
        error_500=round(float(returns.std(ddof=1) / np.sqrt(num_goals)), 1),
        return_200=round(float(rewards[:, :SHORT].sum(axis=1).mean()), 1),
        success=round(float(successes.any(axis=1).mean()), 3),
        success_last=round(float(successes[:, -1].mean()), 3),
    )


def compare(num_goals: int, task_name: str) -> tuple[Row, Row]:
    """(before, after) of one task."""
    env = MetaworldEnv(task_name)
    return measure(env, True, num_goals), measure(env, False, num_goals)


def main() -> None:
    names = [task.name for task in get_family("mt50").tasks]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tasks", nargs="*", metavar="TASK", default=list(corrections_of(names)))
    parser.add_argument("--goals", type=int, default=30)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    rows: list[Row] = []
    print(markdown_table(COLUMNS, []), flush=True)
    for pair in map_blocks(partial(compare, args.goals), args.tasks, args.workers):
        for row in pair:
            rows.append(row)
            cells = (
                row.task, row.expert, f"{row.return_500:.0f} ± {row.error_500:.0f}",
                f"{row.return_200:.0f}", f"{row.success:.2f}", f"{row.success_last:.2f}",
            )  # fmt: skip
            print(markdown_line(cells), flush=True)
        if args.json:
            args.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
