"""Recorded: the environment that imported data say they are from, as a family's `env`.

    file   task -> id, arguments        Pendulum-v1, {"g": 9.0}
    here   gymnasium.make(id, **arguments)   of what gymnasium and installed packages registered

A file chooses among what is registered, and imports nothing: an id with a module in it, text as an
argument and wrappers are refused. Packages that register only when they are imported are named by
the user, in MPDT_GYMNASIUM.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

from mpdt.errors import SimulatorError

if TYPE_CHECKING:
    import gymnasium

    from mpdt.data.spec.family import Task

PACKAGES = "MPDT_GYMNASIUM"
"""Environment variable: packages, by commas, that register their environments on import."""
_ID = re.compile(r"(?:[A-Za-z0-9][A-Za-z0-9_.-]{0,60}/)?[A-Za-z0-9][A-Za-z0-9_.-]{0,100}")
_OF_MAKE = ("id", "max_episode_steps", "disable_env_checker")
_MOST_NUMBERS = 64
_LARGEST = 1_000_000
"""A frame skip without end would be stepped without end, where nothing can interrupt it."""


def problem(id: Any, arguments: Any) -> str:
    """Why an environment is not made, whoever names it; empty where it is."""
    if not isinstance(id, str):
        return "an id that is no text"
    if ":" in id:
        return f"{id!r} would import the module {id.partition(':')[0]!r}, and data import no code"
    if not _ID.fullmatch(id):
        return f"{id[:80]!r} is no id: letters, digits, . _ - and one /"
    if not isinstance(arguments, Mapping):
        return "arguments that are no block of names"
    for name, value in arguments.items():
        if not isinstance(name, str) or not name.isidentifier() or name in _OF_MAKE:
            return f"argument {str(name)[:40]!r} is none of an environment"
        if not _is_plain(value):
            shown = json.dumps(value, default=str)[:60]
            return (f"argument {name} is {shown}: data choose true, false and numbers up to "
                    f"{_LARGEST:,}, not text, which may be a file or a name of code")  # fmt: skip
    return ""


def _is_plain(value: Any) -> bool:
    if isinstance(value, list):
        return len(value) <= _MOST_NUMBERS and all(_is_number(one) for one in value)
    return value is None or _is_number(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, bool | int | float) and abs(value) <= _LARGEST  # nan is not


@dataclass(frozen=True)
class Recorded:
    """`env(task)` of a family whose data say what they are from.

    Args:
        environments: task, id and arguments as JSON, one of each task.
    Raises: ValueError for one that is refused.
    """

    environments: tuple[tuple[str, str, str], ...]

    def __post_init__(self) -> None:
        for task, id, arguments in self.environments:
            if said := problem(id, json.loads(arguments)):
                raise ValueError(f"task {task}: {said}")

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> Recorded:
        """Of task -> {id, arguments}, as `plain` gives it. Raises: ValueError."""
        try:
            return cls(tuple(
                (task, one["id"], json.dumps(one["arguments"], sort_keys=True, allow_nan=False))
                for task, one in plain.items()
            ))  # fmt: skip
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"no environments of tasks: {error}") from error

    def plain(self) -> dict[str, dict[str, Any]]:
        return {task: {"id": id, "arguments": json.loads(arguments)}
                for task, id, arguments in self.environments}  # fmt: skip

    def missing(self) -> str:
        """An id that nothing registered here; empty where all are."""
        known = registered()
        return next((id for _, id, _ in self.environments if id not in known), "")

    def __call__(self, task: Task, **options: Any) -> gymnasium.Env[Any, Any]:
        """Without its time limit, which the horizon is. Raises: SimulatorError."""
        import gymnasium

        if missing := self.missing():
            raise not_registered(missing)
        id, arguments = {name: (id, text) for name, id, text in self.environments}[task.name]
        return gymnasium.make(id, max_episode_steps=-1, disable_env_checker=True,
                              **json.loads(arguments))  # fmt: skip


def registered() -> frozenset[str]:
    """Every id here. Raises: SimulatorError for a package of MPDT_GYMNASIUM that is not here."""
    _import_named(os.environ.get(PACKAGES, ""))
    import gymnasium

    return frozenset(gymnasium.registry)


def limit_of(id: str) -> int | None:
    """The time limit with which an id is registered."""
    import gymnasium

    found = gymnasium.registry[id].max_episode_steps if id in registered() else None
    return found if found is not None and found > 0 else None


def not_registered(id: str) -> SimulatorError:
    return SimulatorError(
        f"gymnasium has no environment {id} here", where="its data name it",
        hint=f"install the package that registers it; one that does so only when it is imported "
        f"is named in the variable {PACKAGES}",
    )  # fmt: skip


@lru_cache(maxsize=4)
def _import_named(names: str) -> None:
    for name in filter(None, (word.strip() for word in names.split(","))):
        try:
            import_module(name)
        except Exception as error:  # whatever it raises, it is the user's word that is wrong
            raise SimulatorError("a package that cannot be imported", where=f"{PACKAGES}={name}",
                                 found=f"{type(error).__name__}: {error}"[:160]
                                 ) from error  # fmt: skip
