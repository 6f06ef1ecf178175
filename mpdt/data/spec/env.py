"""How anyone builds the simulator of a task: an entry point of ours and JSON arguments.

Whoever recovers an environment from a file or an export runs what stands there. So it is derived
from the family wherever it is written, and never taken over from a file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mpdt.data.spec.entry import ENV_OPTIONS
from mpdt.data.spec.tasks import FAMILIES

ENTRY_POINT = "mpdt.data.sim.gym:make"


def describe_env(spec: Mapping[str, Any], family: str, task: str) -> dict[str, Any]:
    """Of a task under a spec's horizon and options; empty for a family that nobody knows here."""
    known = FAMILIES.get(family)
    if known is None:
        return {}
    horizon, options = spec.get("horizon"), spec.get("env")
    kwargs: dict[str, Any] = {"family": family, "task": task}
    kwargs["horizon"] = horizon if type(horizon) is int and horizon > 0 else known.horizon
    if isinstance(options, Mapping):
        kwargs |= {name: options[name] for name in sorted(ENV_OPTIONS[known.robot] & {*options})
                   if isinstance(options[name], bool | int | float)}  # fmt: skip
    return {"entry_point": ENTRY_POINT, "kwargs": kwargs}
