"""For the tests of whoever writes a family.

def test_my_family():
    mpdt.testing.check_family(my_family)
"""

from __future__ import annotations

from collections.abc import Mapping

from mpdt.data.spec.family import Family
from mpdt.data.spec.tasks import get_family
from mpdt.data.verify.family import check_family as findings_of
from mpdt.data.verify.finding import Finding, Outcome


def check_family(
    family: Family | str,
    *,
    seed: int = 0,
    options: Mapping[str, float | bool] | None = None,
    worker: bool = False,
) -> list[Finding]:
    """What `mpdt-data check-family` looks at.

    Args:
        family: itself, or the name of a known one.
        options: simulator options.
        worker: also in a process that is started for it, which takes some seconds.
    Raises: AssertionError naming every rule that is broken, with the task and the step.
    """
    known = get_family(family) if isinstance(family, str) else family
    found = findings_of(known, seed=seed, options=options, worker=worker)
    broken = [one for one in found if one.outcome is Outcome.FAIL]
    assert not broken, "\n".join(line for one in broken for line in one.lines())
    return found
