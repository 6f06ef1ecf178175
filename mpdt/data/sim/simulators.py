"""The simulator of a family, as its contract names it.

Used by collect/, portions.py, probe.py, verify/replay.py, card/film.py and mpdt/train/evaluate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mpdt.data.sim.batch import BatchEnv
from mpdt.data.spec.family import Family, Task, resolve
from mpdt.data.spec.recorded import Recorded, not_registered
from mpdt.data.spec.tasks import get_family
from mpdt.errors import MpdtError, SimulatorError, SpecError, UsageError


def make_batch(
    family: Family, tasks: Sequence[Task], env: Mapping[str, float | bool] | None = None
) -> BatchEnv:
    """The simulator of `family` with one row per entry of `tasks`.

    Args:
        family: its `batch`, `vector` or `env` simulates.
        tasks: task of each row; the same task may stand in many rows.
        env: simulator options of the spec.

    Raises: SpecError for an empty `tasks` or an option the simulator does not have; SimulatorError
    for a family whose simulator is not here, or breaks the contract.
    """
    if not tasks:
        raise SpecError("a batch needs at least one task", where=family.name)
    options = dict(env or {})
    for option in sorted(options.keys() - family.options):
        raise SpecError(
            f"unknown simulator option '{option}'",
            where=f"{family.name}.env",
            hint=f"allowed: {', '.join(sorted(family.options)) or 'none, leave `env` out'}",
        )
    # Resolved here: a command pays only for the simulator it uses.
    if family.batch is not None:
        batch: BatchEnv = resolve(family.batch)(family, tasks, options)
        return batch
    if family.vector is not None:
        from mpdt.data.sim.vectors import VectorBatch

        return VectorBatch(family, tasks, options)
    if family.env is not None and family.simulates:
        from mpdt.data.sim.single import EnvBatch

        return EnvBatch(family, tasks, options)
    raise not_installed(family)


def not_installed(family: Family) -> MpdtError:
    """What is raised where a file alone tells of a family."""
    try:
        get_family(family.name)
    except SpecError as error:  # it is declared, and cannot be used
        return error
    except UsageError:
        pass
    if isinstance(family.env, Recorded) and (missing := family.env.missing()):
        return not_registered(missing)
    if not family.module:
        return SimulatorError(
            "nobody simulates this family: its data were imported", where=family.name,
            hint="a family of that name, columns and bounds in ./datasets.yaml or an installed "
            "package would",
        )  # fmt: skip
    module = family.module
    return SimulatorError(
        "the simulator of this family is not here", where=family.name,
        expected=f"{module}, version {family.version}",
        hint=f"install the package that has it, or add to ./datasets.yaml  families: "
        f"{{{family.name}: {{module: '{module}'}}}}",
    )  # fmt: skip
