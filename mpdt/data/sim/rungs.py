"""Which snapshots of a training run become rungs: judge them all, then spread them evenly.

snapshot   0    1    2   ..   S
returns    per task, with the noise the data is collected with
levels     (R - R_random) / (R_final - R_random)      final = best mean return
rungs      first, final, one near level 0.5 for every task, the rest evenly between
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mpdt.data.sim.batch import BoolArray, FloatArray, roll_out
from mpdt.data.sim.network import behaviour_inputs, network_actions
from mpdt.data.sim.network_file import Weights, load_snapshot
from mpdt.data.sim.simulators import make_batch
from mpdt.data.spec.family import Family
from mpdt.disk import disk, write_bytes
from mpdt.errors import FormatError, SimulatorError
from mpdt.seeding import Quality, SeedKey, Stream

CAREFUL = 8
"""Times the episodes, for the final snapshot and those that may become medium."""
JUDGED = "judged.json"
NEAR = 0.3
"""Of one half, by the mean level over tasks."""


def describe_rungs(
    family: Family,
    work: Path,
    *,
    num_rungs: int,
    episodes: int,
    noise: float,
    seed: int,
    threads: int,
    say: Callable[[str], None],
) -> dict[str, Any]:
    """Judge the snapshots `<step>.safetensors` in `work` and choose the rungs among them.

    What was judged is kept in `work/judged.json`, so a stopped run goes on where it was.
    Returns `random` (return per task) and `rungs` (train_step, returns and levels per task).
    """
    paths = sorted(work.glob("[0-9]*.safetensors"))
    cache = work / JUDGED
    judged = _read_judged(cache, len(family.tasks))

    def returns_of(path: Path | None, count: int) -> NDArray[np.float64]:
        name = f"{path.stem if path else 'random'} x{count}"
        if name not in judged:
            weights = load_snapshot(path) if path else None
            judged[name] = judge(family, weights, count, noise, seed, threads).tolist()
            write_bytes(cache, msgspec.json.encode(judged))
            say(f"judged {name}, of {len(paths)} snapshots")
        return np.array(judged[name])

    random = returns_of(None, CAREFUL * episodes)
    returns = np.array([returns_of(path, episodes) for path in paths])
    best = 1 + int(returns[1:].mean(axis=1).argmax())  # the untrained one is never final
    returns = returns[: best + 1]
    returns[best] = returns_of(paths[best], CAREFUL * episodes)
    names = [task.name for task in family.tasks]
    _check_learnt(family, returns[-1], random, say)
    # A few episodes find the snapshots near one half; more decide which is nearest.
    levels = ((returns - random) / (returns[-1] - random)).mean(axis=1)
    for i in np.flatnonzero(np.abs(levels - 0.5) <= NEAR):
        returns[i] = returns_of(paths[i], CAREFUL * episodes)
    levels = (returns - random) / (returns[-1] - random)

    def per_task(values: NDArray[np.float64]) -> dict[str, float]:
        return {name: round(float(value), 4) for name, value in zip(names, values, strict=True)}

    return {
        "random": per_task(random),
        "rungs": [
            {
                "train_step": int(paths[i].stem),
                "returns": per_task(returns[i]),
                "levels": per_task(levels[i]),
            }
            for i in choose_rungs(levels, num_rungs)
        ],
    }


def _check_learnt(
    family: Family, final: FloatArray, random: FloatArray, say: Callable[[str], None]
) -> None:
    """Tells of tasks in which nothing was learnt. Raises: SimulatorError where no level exists."""
    behind = np.flatnonzero(final <= random)
    if not behind.size:
        return
    some = ", ".join(f"{family.tasks[i].name} {final[i]:.4g}, uniform {random[i]:.4g}"
                     for i in behind[:3])  # fmt: skip
    what = f"no better than uniform actions in {len(behind)} of {len(random)} tasks"
    say(f"warning: {what}: {some}")
    if (final == random).any():
        raise SimulatorError(f"the network is {what}", where=family.name, found=some,
                             hint="train longer (--steps), or does the reward depend on the "
                             "actions?")  # fmt: skip


def _read_judged(cache: Path, num_tasks: int) -> dict[str, list[float]]:
    """What earlier sessions judged. Raises: FormatError; StorageError."""
    with disk(cache):
        content = cache.read_bytes() if cache.exists() else b"{}"
    try:
        judged = msgspec.json.decode(content, type=dict[str, list[float]])
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise _not_judged(cache, str(error)) from error
    if any(len(returns) != num_tasks for returns in judged.values()):
        raise _not_judged(cache, "another number of tasks")
    return judged


def _not_judged(cache: Path, found: str) -> FormatError:
    return FormatError("not a list of judged snapshots", where=str(cache), found=found[:160],
                       hint="move it away, and they are judged again")  # fmt: skip


def judge(
    family: Family, weights: Weights | None, episodes: int, noise: float, seed: int, threads: int
) -> NDArray[np.float64]:
    """Mean return per task of a network, or of uniform actions where `weights` is None.

    Plays `episodes` episodes of every task side by side, with Gaussian action noise.
    Returns (num_tasks,) in the task's own reward.
    """
    tasks = [task for task in family.tasks for _ in range(episodes)]
    keys = [
        SeedKey(seed, family.id, task.index, Quality.PRETRAINING, 0, row)
        for row, task in enumerate(tasks)
    ]
    env = make_batch(family, tasks)
    if hasattr(env, "use_threads"):
        env.use_threads(threads)
    goals = env.draw_goals(keys)
    stacked = np.array(goals)
    observations = env.reset(keys, goals)
    generator = keys[0].generator(Stream.POLICY)
    total, shape = np.zeros(len(tasks)), (len(tasks), family.action_size)

    def choose(
        step: int, seen: FloatArray, rewards: FloatArray | None, running: BoolArray
    ) -> NDArray[np.float32]:
        # All rows share one generator: a judged return is no stored episode.
        if weights is None:
            actions = generator.uniform(family.action_low, family.action_high, shape)
        else:
            inputs = behaviour_inputs(family, seen, stacked)
            actions = network_actions(weights, inputs) + noise * generator.standard_normal(shape)
        return np.clip(actions, family.action_low, family.action_high).astype(np.float32)

    for rolled in roll_out(env, observations, choose, family.horizon):
        total += np.where(rolled.running, rolled.result.rewards, 0.0)
    return np.asarray(total.reshape(len(family.tasks), episodes).mean(axis=1))


def choose_rungs(levels: NDArray[np.float64], num_rungs: int) -> list[int]:
    """Snapshots that become rungs, ascending.

    levels (S, K): normalised return of S snapshots on K tasks; the last one is final, so its
    level is 1. Always contains the first, the last and, for as few snapshots as possible, one
    within [0.4, 0.6] for every task (the nearest to 0.5 where none is); the rest is spread
    evenly over the mean level.
    """
    num_snapshots = len(levels)
    if num_snapshots <= num_rungs:
        return list(range(num_snapshots))
    distance = np.abs(levels - 0.5)
    good = distance <= np.maximum(0.1, distance.min(axis=0))
    chosen = {0, num_snapshots - 1}
    missing = ~good[sorted(chosen)].any(axis=0)
    while missing.any():
        pick = int(good[:, missing].sum(axis=1).argmax())
        chosen.add(pick)
        missing &= ~good[pick]
    mean = levels.mean(axis=1)
    while len(chosen) < num_rungs:
        chosen.add(_widest_gap(mean, chosen))
    return sorted(chosen)


def _widest_gap(mean: NDArray[np.float64], chosen: set[int]) -> int:
    """The free snapshot nearest the middle of the widest gap between chosen mean levels.

    A gap that no snapshot lies in stays a gap: learning may jump there.
    """
    free = [i for i in range(len(mean)) if i not in chosen]
    ends = sorted(mean[i] for i in chosen)
    gaps = sorted(itertools.pairwise(ends), key=lambda gap: gap[0] - gap[1])
    for low, high in gaps:
        inside = [i for i in free if low < mean[i] < high]
        if inside:
            return min(inside, key=lambda i: abs(mean[i] - (low + high) / 2))
    return free[-1]  # all free levels equal chosen ones, so the latest is as good as any
