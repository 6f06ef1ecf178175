"""The verb that looks at a family. Its body imports lazily."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from mpdt.data.verbs.options import Options


@dataclass(frozen=True, kw_only=True)
class CheckFamily(Options):
    """Check that a family keeps its contract: determinism, shapes, ends, tasks, time per step.

    For families of your own, which datasets.yaml, an installed package or a program declares.

    Examples:
      mpdt-data check-family point_robot
      mpdt-data check-family point_robot --spec mine.yaml --seed 3
      mpdt-data check-family cheetah_dir --json
    """

    name: Annotated[Positional[str], arg(metavar="FAMILY")]
    """Name of the family."""
    seed: int = 0
    """Root seed of what is tried."""
    spec: Annotated[Path | None, arg(metavar="YAML")] = None
    """Another datasets.yaml than ./datasets.yaml or the shipped one."""

    def run(self) -> None:
        from mpdt.data.spec.catalog import load_catalog
        from mpdt.data.spec.tasks import get_family
        from mpdt.data.verify.family import check_family
        from mpdt.data.verify.finding import Outcome
        from mpdt.data.verify.verify import summary
        from mpdt.errors import DataError, UsageError

        if self.seed < 0:
            raise UsageError("a negative seed", where="--seed", expected="0 or more",
                             found=str(self.seed))  # fmt: skip
        if self.spec is not None:
            load_catalog(self.spec)  # it declares families
        try:
            family = get_family(self.name)
        except UsageError:
            load_catalog()  # a mistake in datasets.yaml comes before a name that it may hide
            raise
        found = check_family(family, seed=self.seed)
        self.print(
            {"family": family.name, "version": family.version, "module": family.module,
             "summary": summary(found), "rules": [one.as_json() for one in found]},
            "\n".join([line for one in found for line in one.lines()] + [summary(found)]),
        )  # fmt: skip
        if failed := [one for one in found if one.outcome is Outcome.FAIL]:
            raise DataError(
                f"{len(failed)} of {len(found)} rules: {', '.join(one.id for one in failed)}",
                where=f"{family.name} ({family.module or 'mpdt'})",
            )
