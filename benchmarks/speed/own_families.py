"""Families of one's own, as examples/families has them: the generic way beside a plain loop.

    python benchmarks/speed/own_families.py [--rounds 5] [--keep]

ours    `EnvBatch`: the family's gymnasium environments in rows, stepped side by side, every answer
        looked at
limit   the same environments stepped in a plain loop, whole episodes, nothing looked at or kept
peer    Minari's collector around one of them
All get the same ready-made actions. One process.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import rounds

ROWS = 20
CASES = {"point_robot": 4_000, "pendulum_params": 8_000, "hopper_params": 4_000,
         "walker_params": 4_000}  # fmt: skip
"""Steps in a round."""
LEAST = 1 / 1.15
PEER_STEPS = 1_000


def family_of(name: str) -> Any:
    """A family of examples/families, whether or not the package is installed."""
    from mpdt.data.spec.own import load_family

    folder = str(rounds.ROOT / "examples/families")
    return load_family(name, {"module": f"mpdt_families.{name}:{name}"}, folder)


def actions_of(family: Any, rows: int) -> np.ndarray:
    generator = np.random.default_rng(0)
    shape = (rows, family.horizon, family.action_size)
    return generator.uniform(family.action_low, family.action_high, shape).astype(np.float32)


def ours(family: Any, steps: int) -> Callable[[], float]:
    from mpdt.data.sim.simulators import make_batch
    from mpdt.seeding import Quality, SeedKey

    env = make_batch(family, [family.tasks[row % len(family.tasks)] for row in range(ROWS)])
    keys = [SeedKey(0, family.id, 0, Quality.CALIBRATION, 0, row) for row in range(ROWS)]
    actions, goals = actions_of(family, ROWS), env.draw_goals(keys)

    def run() -> float:
        done = 0
        while done < steps:
            env.reset(keys, goals)
            for step in range(family.horizon):
                env.step(actions[:, step])
            done += ROWS * family.horizon
        return done

    return run


def plain(family: Any, steps: int) -> Callable[[], float]:
    envs = [family.env(family.tasks[row % len(family.tasks)]) for row in range(ROWS)]
    actions = actions_of(family, ROWS)

    def run() -> float:
        done = 0
        while done < steps:
            for row, env in enumerate(envs):
                env.reset(seed=row)
                for action in actions[row]:
                    env.step(action)
            done += ROWS * family.horizon
        return done

    return run


def collector(family: Any) -> Callable[[], float]:
    import gymnasium
    import minari

    env = gymnasium.wrappers.TimeLimit(family.env(family.tasks[0]), family.horizon)
    env.unwrapped.spec = gymnasium.envs.registration.EnvSpec(
        "Bench-v0", entry_point="mpdt.data.sim.gym:make",
        kwargs={"family": family.name, "task": family.tasks[0].name})  # fmt: skip
    wrapped, feed = minari.DataCollector(env), itertools.cycle(actions_of(family, 1)[0])

    def run() -> float:
        wrapped.reset(seed=0)
        for _ in range(PEER_STEPS):
            *_, terminated, truncated, _ = wrapped.step(next(feed))
            if terminated or truncated:
                wrapped.reset()
        return PEER_STEPS

    return run


def measure(report: rounds.Report) -> None:
    for name, steps in CASES.items():
        family = family_of(name)
        found = [rounds.Way("mpdt, 20 rows", "ours", ours(family, steps), steps),
                 rounds.Way("plain loop", "limit", plain(family, steps), steps)]  # fmt: skip
        if rounds.have("jax"):  # Minari's collector imports it
            with rounds.without_output():
                make = partial(collector, family)
                found.append(rounds.Way("Minari DataCollector", "peer", make(), PEER_STEPS))
        report.compare(name, "env steps/s", found, [rounds.Target("plain loop", LEAST)])


if __name__ == "__main__":
    sys.path.insert(0, str(rounds.ROOT / "examples/families"))
    rounds.main("own_families", measure, ("mpdt/data", "examples/families"))
