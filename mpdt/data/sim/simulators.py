"""Which simulator a family needs: the one place that knows all of them.

Used by collect/, portions.py, probe.py, verify/replay.py, card/film.py and mpdt/train/evaluate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mpdt.data.sim.batch import BatchEnv
from mpdt.data.spec.tasks import Family, Task
from mpdt.errors import SpecError


def make_batch(
    family: Family, tasks: Sequence[Task], env: Mapping[str, float | bool] | None = None
) -> BatchEnv:
    """The simulator of `family` with one row per entry of `tasks`.

    Args:
        family: row of the family registry; its `simulator` decides.
        tasks: task of each row; the same task may stand in many rows.
        env: simulator options of the spec; Meta-World has none.

    Raises: SpecError for an empty `tasks` or an option the simulator does not have.
    """
    if not tasks:
        raise SpecError("a batch needs at least one task", where=family.name)
    options = dict(env or {})
    # Imported here: a command pays only for the simulator it uses.
    if family.simulator == "metaworld":
        from mpdt.data.sim.metaworld import MetaworldBatch

        if options:
            raise SpecError(
                f"unknown simulator option '{sorted(options)[0]}'",
                where=f"{family.name}.env",
                hint="Meta-World is stepped as published: leave `env` out",
            )
        return MetaworldBatch(tasks)
    from mpdt.data.sim.locomotion import LocomotionBatch

    return LocomotionBatch(family, tasks, options)
