"""How anyone builds the simulator of a task: an entry point of ours and JSON arguments.

Whoever recovers an environment from a file or an export runs what stands there. So it is derived
from the family wherever it is written, and never taken over from a file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mpdt.data.spec.family import stored_family
from mpdt.data.spec.tasks import FAMILIES

ENTRY_POINT = "mpdt.data.sim.gym:make"


def describe_env(
    spec: Mapping[str, Any], family: str, task: str, definition: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Of a task under a spec's horizon and options; empty for a family that nobody knows here.

    Args:
        definition: what a file says of one's own family. It is not looked for, nor imported.
    """
    known = stored_family(definition) if definition else FAMILIES.get(family)
    if known is None:
        return {}
    horizon, options = spec.get("horizon"), spec.get("env")
    kwargs: dict[str, Any] = {"family": family, "task": task}
    kwargs["horizon"] = horizon if type(horizon) is int and horizon > 0 else known.horizon
    if isinstance(options, Mapping):
        kwargs |= {name: options[name] for name in sorted(known.options & {*options})
                   if isinstance(options[name], bool | int | float)}  # fmt: skip
    return {"entry_point": ENTRY_POINT, "kwargs": kwargs}
