"""An import that is simulated: what its environment has to keep, and what it is measured by.

check-family's rules    all but those about bytes have to hold; without those nothing replays
zero, random            what they return, measured here, in place of what the data call random
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mpdt.data.exchange.incoming import Incoming
from mpdt.data.reference import Reference, References
from mpdt.data.sim.actors import Policy, UniformPolicy, ZeroPolicy
from mpdt.data.sim.play import run_block
from mpdt.data.sim.simulators import make_batch
from mpdt.data.spec.family import Family, Task, own_definition, stored_family
from mpdt.data.verify.family import EXACT, check_family
from mpdt.data.verify.finding import Outcome
from mpdt.errors import DataError
from mpdt.seeding import Quality, SeedKey

EPISODES = 100
"""Of each reference, side by side."""
SEED = 1


def simulated(incoming: Incoming, say: Callable[[str], None]) -> Incoming:
    """An import whose header names environments, checked and with references measured here.

    Raises: DataError naming the rules that its environment breaks; SimulatorError.
    """
    family = stored_family(incoming.header.definition)
    say(f"checking {family.name} as `check-family` does")
    found = check_family(family, worker=False)
    broken = [one for one in found if one.outcome is Outcome.FAIL]
    if any(one.id not in EXACT for one in broken):
        first = next(one for one in broken if one.id not in EXACT)
        raise DataError(f"the environment breaks the rule `{first.id}` of families",
                        where=family.name, found=first.text[:300],
                        hint="import without --env: the data are good without it")  # fmt: skip
    remarks = [*incoming.remarks]
    if broken:
        family = replace(family, exact=False)
        remarks.append(
            f"{family.name} is not exact, so nothing is replayed: {broken[0].text[:200]}"
        )
    elif "seeds" not in incoming.header.spec["import"]:
        remarks.append("no replay: not every episode says the seed alone that it began with")
    tasks = []
    for number, row in enumerate(incoming.header.tasks, 1):
        say(f"measuring zero and random, {EPISODES} episodes each   {number}/{len(family.tasks)} "
            f"tasks: {row.name}")  # fmt: skip
        known = {**row.references.by_name, **_measured(family, family.task(row.name))}
        tasks.append(replace(row, references=References(known)))
    header = replace(incoming.header, tasks=tasks, definition=own_definition(family))
    return replace(incoming, header=header, remarks=tuple(remarks))


def _measured(family: Family, task: Task) -> dict[str, Reference]:
    actors: dict[str, tuple[Quality, Policy]] = {
        "zero": (Quality.REFERENCE_ZERO, ZeroPolicy(family.action_size)),
        "random": (Quality.REFERENCE_RANDOM, UniformPolicy(
            family.action_size, family.action_low, family.action_high)),
    }  # fmt: skip
    found = {}
    for name, (quality, policy) in actors.items():
        keys = [SeedKey(SEED, family.id, task.index, quality, 0, row) for row in range(EPISODES)]
        env = make_batch(family, [task] * EPISODES)
        episodes = run_block(env, policy, keys, horizon=family.horizon, quality=-1, progress=-1.0)
        returns = np.array([episode.episode_return for episode in episodes], np.float64)
        successes = np.array([episode.success for episode in episodes], np.bool_)
        told = successes if family.has_success else None
        found[name] = Reference.of(returns, told, source="local")
    return found
