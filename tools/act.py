"""Act from a policy's bundle in plain gymnasium loops: the last step of `make demo`.

    python tools/act.py runs/cheetah_dir-demo/policy [STEPS]         one episode of each task
    python tools/act.py DIR --results runs/cheetah_dir-demo/results.json

Needs the folder and nothing else of the run: no data, no trainer. With results, the episodes that
judged the training tasks are lived through again, one environment after the other, and their mean
returns have to be those of the table, to the last bit; exit code 1 if one is not.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch  # noqa: F401, what loading costs beside it

import mpdt
import mpdt.envs
from mpdt.seeding import Quality, SeedKey, Stream


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="a bundle, or the folder of a run")
    parser.add_argument("steps", type=int, nargs="?", help="of an episode; default: the data's")
    parser.add_argument("--results", type=Path, help="results.json to be equal to")
    options = parser.parse_args()
    began = time.perf_counter()
    policy = mpdt.load_policy(options.folder)
    print(f"{options.folder}: loaded in {time.perf_counter() - began:.2f} s")
    if options.results:
        return compare(policy, json.loads(options.results.read_text()), facts_of(options.folder))
    for task in policy.tasks:
        env = environment(policy, task, {"horizon": options.steps} if options.steps else {})
        began = time.perf_counter()
        earned, steps = live(policy, env, task, seed=0)
        seconds = time.perf_counter() - began
        print(f"{task:<10} {steps} steps in {seconds:.1f} s, return {earned:.1f}")
    return 0


def compare(policy: Any, results: dict[str, Any], facts: dict[str, Any]) -> int:
    """Exit code of acting as the training tasks were judged."""
    told = {
        score["task"]: score["mean"]
        for score in results["scores"]
        if score["block"] == "train" and score["method"] == facts["training"]["method"]
    }
    settings, data = facts["training"]["settings"]["evaluation"], facts["data"]
    horizon = settings["horizon"] or data["horizon"]
    same, steps = True, 0
    began, used = time.perf_counter(), time.process_time()
    for task in policy.tasks:
        env = environment(policy, task, {"horizon": horizon, **data["options"]})
        returns = np.zeros(settings["train_episodes"] or settings["episodes"])
        for episode in range(len(returns)):
            index = policy.family.task(task).index
            key = SeedKey(settings["seed"], policy.family.id, index, Quality.EVALUATION, 0, episode)
            # What an episode of Meta-World begins with is its goal, and nothing else.
            stream = Stream.GOAL if policy.family.draws_goals else Stream.RESET
            returns[episode], lived = live(policy, env, task, key.env_seed(stream))
            steps += lived
        found = float(returns.mean())
        same &= found == told[task]
        verdict = "equal" if found == told[task] else f"the table says {told[task]!r}"
        print(f"{task:<10} {len(returns)} episodes, mean return {found!r}: {verdict}")
    seconds, used = time.perf_counter() - began, time.process_time() - used
    dtype = facts["backbone"]["dtype"]
    print(f"{steps:,} steps in {seconds:.1f} s, {used:.1f} s of processor time, {dtype}")
    return 0 if same else 1


def live(policy: Any, env: Any, task: str, seed: int) -> tuple[float, int]:
    """Return and steps of one episode: the plain loop."""
    policy.task = task
    observation, reward, over, earned, steps = env.reset(seed=seed)[0], None, False, 0.0, 0
    while not over:
        observation, reward, terminated, truncated, _ = env.step(policy.act(observation, reward))
        # As the data counts: float32 rewards, summed in float64.
        over, earned, steps = terminated or truncated, earned + float(np.float32(reward)), steps + 1
    return earned, steps


def environment(policy: Any, task: str, options: dict[str, Any]) -> Any:
    """The registered one of this family."""
    family = policy.family
    if "metaworld" in family.packages:
        return gymnasium.make("mpdt/MetaWorld-v0", family=family.name, task=task, **options)
    name = "".join(part.capitalize() for part in family.name.split("_"))
    return gymnasium.make(f"mpdt/{name}-v0", task=task, **options)


def facts_of(folder: Path) -> dict[str, Any]:
    """What the bundle's config.json says; `load_policy` has proved it."""
    if (folder / "policy").is_dir():
        folder /= "policy"
    facts: dict[str, Any] = json.loads((folder / "config.json").read_text())
    return facts


if __name__ == "__main__":
    sys.exit(main())
