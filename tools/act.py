"""Act from a policy's bundle in a plain gymnasium loop: the last step of `make demo`.

    python tools/act.py runs/cheetah_dir-demo/policy [STEPS]

Needs the folder and nothing else of the run: no data, no trainer.
"""

from __future__ import annotations

import sys
import time

import gymnasium
import torch  # noqa: F401, what loading costs beside it

import mpdt
import mpdt.envs


def main() -> None:
    folder, steps = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 200
    began = time.perf_counter()
    policy = mpdt.load_policy(folder)
    print(f"{folder}: loaded in {time.perf_counter() - began:.2f} s")
    name = "".join(part.capitalize() for part in policy.family.name.split("_"))
    for task in policy.tasks:
        policy.task = task
        env = gymnasium.make(f"mpdt/{name}-v0", task=task, horizon=steps)
        observation, reward, over, total = env.reset(seed=0)[0], None, False, 0.0
        began = time.perf_counter()
        while not over:
            observation, reward, terminated, truncated, _ = env.step(
                policy.act(observation, reward)
            )
            over, total = terminated or truncated, total + float(reward)
        seconds = time.perf_counter() - began
        print(f"{task:<10} {steps} steps in {seconds:.1f} s, return {total:.1f}")


if __name__ == "__main__":
    main()
