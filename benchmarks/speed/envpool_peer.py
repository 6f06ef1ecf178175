"""EnvPool beside ours: environments in C++, stepped by two threads, in an interpreter of its own.

    rounds.py's process                       build/envpool/bin/python envpool_peer.py
      {"steps": 20000, "case": "cheetah"}  ->   sends and receives batches
                          20016            <-   steps done, resets not counted

EnvPool 1.2.5 brings its own MuJoCo, 3.6.0 where ours is 3.3.0, and pins packages that ours does
not; so it has an environment of its own (`make bench` makes it). What is kind to it:

- its asynchronous way, half of its environments at a time, which it documents as its fastest;
- actions are ready-made and nothing is kept of what it returns, let alone written;
- its ant leaves out contact forces as ours does; `post_constraint`, which fills numbers that
  nothing here reads, is switched off;
- one long life: no start-up, no first compilation.

Its Meta-World draws its own goals and hides them from the observation, so ready-made actions of our
scripts bring the arm into contact as often as ours but do not always succeed.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PYTHON = ROOT / "build" / "envpool" / "bin" / "python"
NAME = "EnvPool 1.2.5"
PLAIN = {"max_episode_steps": 200, "post_constraint": False}
ROBOTS = {
    "cheetah": ("HalfCheetah-v5", PLAIN),
    "ant": ("Ant-v4", PLAIN | {"use_contact_force": False}),
}
ROWS, HORIZON, READY = 16, 500, 64
"""Environments at once, steps of a Meta-World episode, made-up actions of each."""


def is_there() -> bool:
    if PYTHON.exists():
        return True
    print(f"({NAME} is not installed in {PYTHON.parents[1].relative_to(ROOT)}: left out)")
    return False


@contextmanager
def envpool(threads: int, actions: Path | None = None) -> Iterator[Callable[..., float]]:
    """Yields `run(case, steps)`: steps done in it.

    Args:
        actions: .npz, task -> (rows, steps, 4).
    """
    words = [str(PYTHON), __file__, str(threads), str(actions or "")]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                          stderr=subprocess.DEVNULL, text=True) as process:  # fmt: skip
        assert process.stdin is not None and process.stdout is not None

        def run(case: str, steps: int) -> float:
            process.stdin.write(json.dumps({"case": case, "steps": steps}) + "\n")  # type: ignore
            process.stdin.flush()  # type: ignore
            answer = process.stdout.readline()  # type: ignore
            if not answer:
                raise SystemExit(f"error: {NAME} ended at {case}")
            return float(answer)

        yield run
        process.stdin.close()


def title(task: str) -> str:
    """push-back -> MetaWorld/PushBack-v3"""
    return "MetaWorld/" + "".join(part.capitalize() for part in task.split("-")) + "-v3"


class Pool:
    """Environments of one name. Args: actions: (rows, steps, A); row i belongs to environment i."""

    def __init__(self, name: str, threads: int, actions: Any, options: dict[str, Any]) -> None:
        import envpool as package  # in this interpreter it is the package

        rows = len(actions)
        self._envs = package.make_gymnasium(
            name, num_envs=rows, batch_size=rows // 2, num_threads=threads, **options)  # fmt: skip
        self._actions = actions.astype(self._envs.action_space.dtype)
        self._envs.async_reset()

    def run(self, steps: int) -> int:
        done = 0
        while done < steps:
            *_, told = self._envs.recv()
            rows, passed = told["env_id"], told["elapsed_step"]
            done += int((passed > 0).sum())  # 0: it was a reset
            self._envs.send(self._actions[rows, passed % self._actions.shape[1]], rows)
        return done


def serve(threads: int, actions: str) -> None:
    import numpy as np

    ready = dict(np.load(actions)) if actions else {}
    generator, pools = np.random.default_rng(0), {}
    for line in sys.stdin:
        asked = json.loads(line)
        case = asked["case"]
        if case not in pools:
            if case in ROBOTS:
                name, options = ROBOTS[case]
                drawn = generator.uniform(-1, 1, (ROWS, READY, 6 if case == "cheetah" else 8))
            else:
                task, _, actor = case.partition("/")
                name, options = title(task), {"max_episode_steps": HORIZON}
                drawn = (ready[task] if actor == "script"
                         else generator.uniform(-1, 1, (len(ready[task]), HORIZON, 4)))  # fmt: skip
            pools[case] = Pool(name, threads, np.clip(drawn, -1, 1), options)
        print(pools[case].run(asked["steps"]), flush=True)


if __name__ == "__main__":
    serve(int(sys.argv[1]), sys.argv[2])
