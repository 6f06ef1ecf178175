"""Check a family: its determinism is shown, not hoped for.

    stepping     makes, resets and steps: shapes, types, finite numbers, at the bounds too
    seed         two simulators, the same keys and actions: the same bytes
    reset        a reset forgets whatever came before
    neighbours   a row alone is what it was beside others
    globals      random, numpy.random and torch are where they were
    worker       the same bytes in a process that was started for it
    endings      an episode ends as the family says, and at no limit of its own
    tasks        two tasks are two, and a hidden goal stands in no column that is stored
    scripts      the same answer twice, better than uniform actions
    speed        time per step, and beside the family's own environments in a plain loop

Each failure names the task and the step. A family that says `exact: false` is not held to the four
rules about bytes.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from mpdt.data.episode import Episode
from mpdt.data.sim.actors import Policy, UniformPolicy, uniform_actions
from mpdt.data.sim.mixed import script_policy
from mpdt.data.sim.play import run_block
from mpdt.data.sim.simulators import make_batch
from mpdt.data.spec.family import Family, Task, resolve
from mpdt.data.verify.finding import Finding, Outcome
from mpdt.data.verify.run import Run, Seen, difference, play
from mpdt.data.workers.processes import map_blocks
from mpdt.errors import MpdtError
from mpdt.seeding import Quality, SeedKey

ROWS = 3
TASKS = 4  # at most, spread over the family's
EPISODES = 8  # of a script and of uniform actions
SECONDS = 0.3  # of stepping, for a rate

EXACT = ("seed", "reset", "neighbours", "worker")


def check_family(
    family: Family,
    *,
    seed: int = 0,
    options: Mapping[str, float | bool] | None = None,
    worker: bool = True,
) -> list[Finding]:
    """What each rule says of a family, in the order of the list above.

    Args:
        seed: root of the keys and actions.
        options: simulator options.
        worker: start a process too; in a script that needs `if __name__ == "__main__":`.
    """
    runs = [_run(family, task, seed, options or {}) for task in _some_tasks(family)]
    found = [_judged("stepping", lambda: _stepping(runs))]
    rules: dict[str, Callable[[], Iterator[str] | str]] = {
        "seed": lambda: _same(runs, lambda run: play(run), "two simulators with the same seeds"),
        "reset": lambda: _same(runs, _again, "a reset after other episodes"),
        "neighbours": lambda: _same(runs, _alone, "a row alone and beside others"),
        "globals": lambda: _globals(runs[0]),
        "worker": lambda: _worker(runs[:1]),
        "endings": lambda: _endings(runs),
        "tasks": lambda: _tasks(family, runs),
        "scripts": lambda: _scripts(family, runs, seed),
        "speed": lambda: _speed(runs[0]),
    }
    stepped = found[0].outcome is Outcome.PASS
    for id, rule in rules.items():
        if id == "worker" and not worker:
            continue
        if not stepped:
            found.append(Finding(id, Outcome.SKIP, "not looked at: it cannot be stepped"))
        elif id in EXACT and not family.exact:
            text = "not held to it: exact is false, so nothing is said of hashes or replay"
            found.append(Finding(id, Outcome.SKIP, text))
        else:
            found.append(_judged(id, rule))
    return found


def _run(family: Family, task: Task, seed: int, options: Mapping[str, float | bool]) -> Run:
    first = SeedKey(seed, family.id, task.index, Quality.CALIBRATION, 0, 0)
    keys = tuple(first.at_row(row) for row in range(ROWS))
    size, low, high = family.action_size, family.action_low, family.action_high
    actions = uniform_actions(keys, family.horizon, size, low, high).astype(np.float32)
    return Run(family, task, keys, np.clip(actions, np.float32(low), np.float32(high)), options)


def _some_tasks(family: Family) -> list[Task]:
    places = np.linspace(0, len(family.tasks) - 1, min(TASKS, len(family.tasks)))
    return [family.tasks[int(place)] for place in places.round()]


def _judged(id: str, rule: Callable[[], Iterator[str] | str]) -> Finding:
    """PASS with what the rule says, FAIL with all that it found wrong."""
    try:
        said = rule()
        faults = [] if isinstance(said, str) else list(said)
    except MpdtError as error:
        return Finding(id, Outcome.FAIL, error.message(), hint=error.hint)
    if faults:
        more = f"; and {len(faults) - 3} more" if len(faults) > 3 else ""
        return Finding(id, Outcome.FAIL, "; ".join(faults[:3]) + more)
    return Finding(id, Outcome.PASS, said if isinstance(said, str) else _PASSED[id])


_PASSED = {
    "seed": "the same seeds, the same bytes",
    "reset": "a reset forgets what came before",
    "neighbours": "a row does not know its neighbours",
    "globals": "no generator that everybody shares was drawn from",
    "worker": "the same bytes in another process",
    "endings": "episodes end as the family says",
    "tasks": "tasks differ, no stored column is a hidden goal",
    "scripts": "the same answers twice, above uniform actions",
}


def _stepping(runs: Sequence[Run]) -> str:
    """Uniform actions, and both bounds."""
    steps = 0
    for run in runs:
        steps += int(play(run).lengths().sum())
        for bound in (run.family.action_low, run.family.action_high):
            steps += int(
                play(replace(run, actions=np.full_like(run.actions, bound))).lengths().sum()
            )
    return f"{len(runs)} tasks, {steps:,} steps, at the bounds too: shapes, types, finite numbers"


def _same(runs: Sequence[Run], other: Callable[[Run], Seen], what: str) -> Iterator[str]:
    for run in runs:
        if fault := difference(run, play(run), other(run)):
            yield f"{what}: {fault}"


def _again(run: Run) -> Seen:
    """On a simulator that has lived through other episodes, the last one only half."""
    env = make_batch(run.family, [run.task] * len(run.keys), run.options)
    others = tuple(key.at_row(key.row + 100) for key in run.keys)
    half = run.actions[::-1, : max(1, run.actions.shape[1] // 2)]
    play(replace(run, keys=others, actions=run.actions[::-1].copy()), env)
    play(replace(run, keys=others, actions=half.copy()), env)
    return play(run, env)


def _alone(run: Run) -> Seen:
    parts = [play(run.rows(slice(row, row + 1))) for row in range(len(run.keys))]
    return Seen(*(np.concatenate([getattr(part, name) for part in parts], axis=1)
                  for name in ("observations", "rewards", "ends")))  # fmt: skip


def _globals(run: Run) -> Iterator[str]:
    before = _global_states()
    play(run)
    for name, state in _global_states().items():
        if state != before.get(name, state):
            yield f"it draws from {name}: use env.np_random, which its reset seeds"


def _global_states() -> dict[str, bytes]:
    """Of the generators that everybody shares, as far as they are loaded."""
    states = {"numpy.random": repr(np.random.get_state()).encode()}  # noqa: NPY002  looked at only
    if "random" in sys.modules:
        states["random"] = repr(sys.modules["random"].getstate()).encode()
    if "torch" in sys.modules:
        states["torch"] = sys.modules["torch"].get_rng_state().numpy().tobytes()
    return states


def _worker(runs: Sequence[Run]) -> Iterator[str]:
    for run, seen in zip(runs, map_blocks(play, list(runs), 1), strict=True):
        if fault := difference(run, play(run), seen):
            yield f"here and in another process: {fault}"


def _endings(runs: Sequence[Run]) -> Iterator[str]:
    for run in runs:
        lengths, family = play(run).lengths(), run.family
        short = np.flatnonzero(lengths < run.actions.shape[1])
        if len(short) and not family.ends_early:
            yield (f"task {run.task.name}, step {lengths[short[0]] - 1}, row {short[0]}: it ends, "
                   "and ends_early is false")  # fmt: skip


def _tasks(family: Family, runs: Sequence[Run]) -> Iterator[str]:
    seen = [play(replace(run, keys=runs[0].keys, actions=runs[0].actions)) for run in runs]
    for (run, found), (other, against) in combinations(zip(runs, seen, strict=True), 2):
        steps = min(int(found.lengths()[0]), int(against.lengths()[0]))
        one, two = (each.observations[: steps + 1, 0] for each in (found, against))
        if one.tobytes() == two.tobytes() and (
            found.rewards[:steps, 0].tobytes() == against.rewards[:steps, 0].tobytes()
        ):
            yield f"tasks {run.task.name} and {other.task.name} are the same in every number"
    if not family.goal_hidden or len(runs) < 2:
        return
    shown = [column for column in range(family.observation_size)
             if column not in family.hidden_columns]  # fmt: skip
    for column in shown:
        for place in range(len(runs[0].task.goal)):
            goals = [run.task.goal[place] for run in runs]
            told = all((found.observations[0, :, column] == goal).all()
                       for found, goal in zip(seen, goals, strict=True))  # fmt: skip
            if told and len(set(goals)) > 1:
                yield (f"reset: {family.columns[column]} is number {place} of the goal: hide the "
                       "column, or say goal_hidden=False")  # fmt: skip


def _scripts(family: Family, runs: Sequence[Run], seed: int) -> Iterator[str]:
    for name in family.scripts:
        for run in runs:
            first, again = (_acted(run, script_policy(family, name, run.task, 0.0), seed)
                            for _ in range(2))  # fmt: skip
            for one, two in zip(first, again, strict=True):
                if one.actions.tobytes() != two.actions.tobytes() and family.exact:
                    steps = np.flatnonzero((one.actions != two.actions).any(axis=1))
                    yield f"script {name}, task {run.task.name}, step {steps[0]}: another answer"
                    break
            uniform = UniformPolicy(family.action_size, family.action_low, family.action_high)
            low, high = (np.mean([episode.episode_return for episode in episodes])
                         for episodes in (_acted(run, uniform, seed), first))  # fmt: skip
            if high <= low:
                yield (f"script {name}, task {run.task.name}: returns {high:.4g}, uniform actions "
                       f"{low:.4g}")  # fmt: skip


def _acted(run: Run, policy: Policy, seed: int) -> list[Episode]:
    first = SeedKey(seed, run.family.id, run.task.index, Quality.CALIBRATION, 1, 0)
    keys = [first.at_row(row) for row in range(EPISODES)]
    env = make_batch(run.family, [run.task] * EPISODES, run.options)
    return run_block(env, policy, keys, horizon=run.family.horizon, quality=-1, progress=-1.0)


def _speed(run: Run) -> str:
    rows = 20
    keys = [run.keys[0].at_row(row) for row in range(rows)]
    env = make_batch(run.family, [run.task] * rows, run.options)
    actions = np.repeat(run.actions[:1], rows, axis=0)
    goals = env.draw_goals(keys)

    def together() -> int:
        env.reset(keys, goals)
        for step in range(actions.shape[1]):
            env.step(actions[:, step])
        return rows * int(actions.shape[1])

    each = _seconds_per_step(together)
    text = f"{1e6 * each:.1f} us per step, {rows} rows side by side"
    if run.family.env is None:
        return text
    single = resolve(run.family.env)(run.task, **run.options)
    given = run.actions[0].astype(single.action_space.dtype)

    def plain() -> int:
        single.reset(seed=keys[0].env_seed())
        steps = 0
        for action in given:
            steps += 1
            if single.step(action)[2]:
                break
        return steps

    return f"{text}; {each / _seconds_per_step(plain):.2f} times a plain loop of its environment"


def _seconds_per_step(episodes: Callable[[], int]) -> float:
    """The quickest of several: other programs only make it slower."""
    best, end = float("inf"), time.perf_counter() + SECONDS
    while time.perf_counter() < end:
        start = time.perf_counter()
        steps = episodes()
        best = min(best, (time.perf_counter() - start) / steps)
    return best
