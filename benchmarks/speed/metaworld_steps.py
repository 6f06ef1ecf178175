"""Collecting Meta-World data: all 50 tasks with their scripts, against the published step.

    python benchmarks/speed/metaworld_steps.py [--rounds 3] [--keep]

ours    one process per core: whole episodes of 500 steps as `collect` simulates them
plain   one process per core: the published `env.reset()` and `env.step()` with the same goals
        and the same scripts; observations, rewards and successes are compared bit for bit
peer    Minari's DataCollector around the published env of one task, in one process
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import rounds

HORIZON = 500
PLAIN = "published env.step"


class Published:
    """One task as Meta-World publishes it, the goal visible and set by hand."""

    def __init__(self, task: str) -> None:
        from mpdt.data.sim.metaworld import find_class, quiet

        with quiet():
            self.env = find_class(task, "env")()
        self.env._partially_observable = False
        del self.env.sawyer_observation_space
        self.env._set_task_called = True

    def play(self, goal: Any, policy: Any, keys: Any, env: Any = None) -> tuple[Any, Any, Any]:
        """Observations, rewards and successes of one episode."""
        from mpdt.data.sim.actors import Rows
        from mpdt.data.sim.metaworld import quiet

        env = env or self.env
        self.env._last_rand_vec = goal
        with quiet():
            observation, _ = env.reset()
            policy.begin(Rows(keys, [goal], HORIZON))
            # Copies: some scripts write into the observation they are shown.
            seen, rewards, wins = [observation.copy()], [], []
            for step in range(HORIZON):
                action = policy.act(step, observation[None])[0].astype(np.float32)
                observation, reward, _, _, info = env.step(np.clip(action, -1, 1))
                seen.append(observation.copy())
                rewards.append(reward)
                wins.append(bool(info["success"]))
        return np.array(seen, np.float32), np.array(rewards, np.float32), np.array(wins)


def ways(number: int, size: int, names: list[str] | None = None) -> dict[str, Callable[[], Any]]:
    """Ours and the published env for every `size`-th task; each returns seconds per task."""
    from mpdt.data.sim.metaworld import MetaworldBatch
    from mpdt.data.sim.play import run_block
    from mpdt.data.sim.scripted import ScriptedPolicy
    from mpdt.data.spec.tasks import get_family
    from mpdt.seeding import Quality, SeedKey

    family = get_family("mt50")
    tasks = [task for task in family.tasks if names is None or task.name in names][number::size]
    first = SeedKey(0, family.id, 0, Quality.EXPERT, 0, 0)
    batches = {task.name: MetaworldBatch([task]) for task in tasks}
    published = {task.name: Published(task.name) for task in tasks}
    policies = {task.name: ScriptedPolicy([task.name]) for task in tasks}
    made: dict[str, Any] = {}

    def timed(play: Callable[[str], Any]) -> dict[str, float]:
        seconds = {}
        for task in tasks:
            began = time.perf_counter()
            play(task.name)
            seconds[task.name] = time.perf_counter() - began
        return seconds

    def ours(name: str) -> None:
        (made[name],) = run_block(
            batches[name], policies[name], [first], horizon=HORIZON, quality=2, progress=1.0
        )

    def plain(name: str) -> None:
        episode = made[name]
        found = published[name].play(episode.goal, policies[name], [first])
        wanted = (episode.observations, episode.rewards, episode.successes)
        for a, b in zip(found, wanted, strict=True):
            assert np.array_equal(a, b), f"{name}: other bytes than the published env"

    return {"ours": lambda: timed(ours), "plain": lambda: timed(plain)}


def collector(name: str) -> Callable[[], float]:
    """Minari's collector around the published env."""
    import gymnasium
    import minari

    from mpdt.data.sim.metaworld import MetaworldEnv
    from mpdt.data.sim.scripted import ScriptedPolicy
    from mpdt.data.spec.tasks import get_family
    from mpdt.seeding import Quality, SeedKey

    published, policy = Published(name), ScriptedPolicy([name])
    key = SeedKey(0, get_family("mt50").id, 0, Quality.EXPERT, 0, 0)
    goal = MetaworldEnv(name).draw(0)
    env = published.env
    # Its own observation space is left out: hidden goals and rounded bounds fail the check.
    env.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (39,), np.float64)
    env.unwrapped.spec = gymnasium.envs.registration.EnvSpec(
        "Bench-v0", entry_point="mpdt.data.sim.gym:make", kwargs={"family": "mt50", "task": name}
    )
    wrapped = minari.DataCollector(env)

    def run() -> float:
        published.play(goal, policy, [key], wrapped)
        return HORIZON

    return run


def measure(report: rounds.Report) -> None:
    size, repeats = rounds.cores(), min(3, report.rounds)
    seconds: dict[str, dict[str, list[float]]] = {}
    with rounds.worker_processes(partial(ways, size=size), size) as team:

        def way(name: str) -> Callable[[], float]:
            def run() -> float:
                parts = [part for member in team(name)() for part in member.items()]
                for task, spent in parts:
                    seconds.setdefault(task, {}).setdefault(name, []).append(spent)
                return float(len(parts) * HORIZON)

            return run

        report.compare(
            "50 tasks, their scripts, 500 steps", "env steps/s",
            [rounds.Way("mpdt", "ours", way("ours"), 0),
             rounds.Way(PLAIN, "limit", way("plain"), 0)],
            [rounds.Target(PLAIN, 1.4)], repeats,
            "every observation, reward and success equal to the published env's, bit for bit",
        )  # fmt: skip
    print("\n  task                          us/step   published   ratio")
    factors = []
    for task, spent in sorted(seconds.items()):
        ours, plain = (statistics.median(spent[key][1:]) for key in ("ours", "plain"))
        factors.append(plain / ours)
        print(f"  {task:28} {ours / HORIZON * 1e6:8.0f} {plain / HORIZON * 1e6:11.0f}"
              f" {factors[-1]:7.2f}")  # fmt: skip
    report.fact("median over tasks of the ratio", statistics.median(factors), "x")
    report.fact("least ratio of a task", min(factors), "x")
    report.fact("greatest ratio of a task", max(factors), "x")
    if not rounds.have("jax"):
        return
    one = ways(0, 1, ["push"])
    one["ours"]()
    try:
        peer = rounds.Way("Minari DataCollector", "peer", collector("push"), HORIZON)
        peer.run()
    except Exception as error:  # noqa: BLE001  whether it runs at all is part of the result
        report.fact("Minari DataCollector runs on push", 0, "", note=f"{error}"[:200])
        return

    def alone(name: str) -> Callable[[], float]:
        def run() -> float:
            one[name]()
            return float(HORIZON)

        return run

    report.compare(
        "push alone, one process", "env steps/s",
        [rounds.Way("mpdt", "ours", alone("ours"), HORIZON),
         rounds.Way(PLAIN, "limit", alone("plain"), HORIZON), peer],
    )  # fmt: skip


if __name__ == "__main__":
    rounds.main("metaworld", measure, ("mpdt/data",))
