"""World: the environments that sets record, as what simulates the family made of them.

sets of a task    agree in id and arguments         limit      the family's horizon
the data          as wide as its spaces, inside its action bounds
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mpdt.data.exchange.own_sources import Found
from mpdt.data.spec.family import Family, Task
from mpdt.data.spec.recorded import Recorded, limit_of, not_registered
from mpdt.errors import DataError, MpdtError, SimulatorError


@dataclass(frozen=True)
class World:
    """Environments by task, and their time limit; None = none."""

    recorded: Recorded
    limit: int | None


def world_of(found: Sequence[Found], tasks: Sequence[str], longest: int) -> World:
    """What the sets say together.

    Args:
        tasks: of each source.
        longest: steps of the longest episode.
    Raises: DataError where two sets of a task disagree, or limits do; SimulatorError for an
        environment that is not registered here.
    """
    plain: dict[str, dict[str, Any]] = {}
    limits: set[int] = set()
    for one, task in zip(found, tasks, strict=True):
        said = {key: one.environment[key] for key in ("id", "arguments")}
        if plain.setdefault(task, said) != said:
            raise DataError(f"two environments of task {task}", where=str(one.path),
                            expected=str(plain[task])[:120], found=str(said)[:120],
                            hint="import them as two tasks, or without --env")  # fmt: skip
        if limit := one.environment["limit"] or limit_of(said["id"]):
            limits.add(limit)
    recorded = Recorded.of(plain)
    if missing := recorded.missing():
        raise not_registered(missing)
    if len(limits) > 1 or (limits and max(limits) < longest):
        raise DataError("no time limit that holds for all", where="--env",
                        expected=f"one, of {longest} steps or more",
                        found=", ".join(map(str, sorted(limits))),
                        hint="import without --env")  # fmt: skip
    return World(recorded, max(limits, default=None))


def with_world(family: Family, world: World, horizon: int | None) -> Family:
    """The family, simulated.

    Args:
        horizon: as the user says it; None = the environments' own limit.
    Raises: SimulatorError for an environment that cannot be made; DataError for one whose spaces
        are not those of the data.
    """
    bounds = {_bounds(family, world.recorded, task) for task in family.tasks}
    if len(bounds) > 1:
        raise DataError("tasks with different bounds of actions", where=family.name,
                        found=str(sorted(bounds)), hint="import without --env")  # fmt: skip
    low, high = bounds.pop()
    names = sorted({id for _, id, _ in world.recorded.environments})
    return replace(
        family, env=world.recorded, action_low=low, action_high=high, ends_early=True, exact=True,
        horizon=horizon or world.limit or family.horizon,
        about=f"imported from {', '.join(names)[:80]}",
    )  # fmt: skip


def _bounds(family: Family, recorded: Recorded, task: Task) -> tuple[float, float]:
    from gymnasium import spaces

    id = {name: id for name, id, _ in recorded.environments}[task.name]
    where = f"task {task.name}, {id}"
    try:
        env = recorded(task)
        seen, acts = env.observation_space, env.action_space
        env.close()
    except MpdtError:
        raise
    except (Exception, SystemExit) as error:
        raise SimulatorError("the environment cannot be made", where=where,
                             found=f"{type(error).__name__}: {error}"[:160],
                             hint="install what it needs, or import without --env"
                             ) from error  # fmt: skip
    for name, space, size in (("observations", seen, family.observation_size),
                              ("actions", acts, family.action_size)):  # fmt: skip
        if not isinstance(space, spaces.Box) or space.shape != (size,):
            raise DataError(f"the environment has other {name} than the data", where=where,
                            expected=f"{size} numbers", found=str(space)[:120],
                            hint="import without --env")  # fmt: skip
    assert isinstance(acts, spaces.Box)
    low, high = float(acts.low.min()), float(acts.high.max())
    if (
        (acts.low != acts.low.min()).any()
        or (acts.high != high).any()
        or not np.isfinite([low, high]).all()
    ):
        raise DataError("one pair of bounds holds for all actions here", where=where,
                        found=f"{acts.low.tolist()} to {acts.high.tolist()}"[:120],
                        hint="import without --env, or write a module that scales them"
                        )  # fmt: skip
    return low, high
