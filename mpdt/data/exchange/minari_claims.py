"""What a Minari set says of its episodes, ours or another's.

dataset_id     mpdt/<family>/<task>/<quality>-v<major>       another's: its last word, <quality>
env_spec       arguments family and task of our environments, env_name of Meta-World's
mpdt           the manifest of our exports: family and licence
options/task, options/quality, options/goal                  of each of our episodes
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.exchange.claims import Said
from mpdt.data.exchange.manifest import KEY
from mpdt.data.exchange.treatment import Rules
from mpdt.data.spec.recorded import problem
from mpdt.data.spec.tasks import FAMILIES, Family
from mpdt.errors import FormatError, UsageError
from mpdt.reading import decode_json

_VERSION = re.compile(r"-v\d+$")


def safe(word: str) -> str:
    """As a part of an id: Minari allows few characters there."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", word)


def said_in(metadata: Mapping[str, Any], family: Family, where: str) -> Said:
    """What the metadata of a set say, each part as far as it can be read.

    Raises: DataError where two parts contradict each other.
    """
    found = _in_id(metadata.get("dataset_id"))
    for other in (_in_env(metadata.get("env_spec"), family), _in_manifest(metadata.get(KEY))):
        found = found.and_also(other, where)
    return found


def said_of_episode(attributes: Mapping[str, Any], rules: Rules) -> Said:
    """What the attributes of one episode say, but for a quality that is taken back."""
    told = ("task",) if rules.quality == "unknown" else ("task", "quality")
    values = {key: attributes.get(f"options/{key}") for key in told}
    return Said.of(values, "its options")


def goal_of(attributes: Mapping[str, Any], where: str) -> NDArray[np.float64] | None:
    """The goal of one of our episodes; None where none is told. Raises: FormatError."""
    if (value := attributes.get("options/goal")) is None:
        return None
    goal = np.asarray(value)
    if goal.dtype.kind not in "fiu" or goal.ndim != 1 or not np.isfinite(goal).all():
        raise FormatError("a goal that is none", where=where, expected="finite numbers",
                          found=f"{goal.dtype} of shape {goal.shape}")  # fmt: skip
    return goal.astype(np.float64)


def seed_of(attributes: Mapping[str, Any]) -> int | None:
    """Of the reset; None where none is told, or where options of the reset were."""
    value = attributes.get("seed")
    if any(name.startswith("options") for name in attributes):
        return None
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        return None
    return int(value) if 0 <= value < 2**64 else None


def environment_in(metadata: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The environment that a set records: `id`, `arguments`, `limit` in steps or None.

    Raises: UsageError for one that is not made, with the reason.
    """
    try:
        spec = decode_json(metadata["env_spec"])
        id, arguments, limit = spec["id"], spec.get("kwargs", {}), spec.get("max_episode_steps")
        wrappers = spec.get("additional_wrappers") or []
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        raise UsageError("the set records no environment", where=where, hint="leave out --env"
                         ) from error  # fmt: skip
    said = problem(id, arguments)
    if wrappers and not said:
        said = "it is wrapped, and the code of wrappers is not taken from data"
    if said:
        raise UsageError("the environment it records is not made", where=where, found=said,
                         hint="leave out --env, or write a module of your own that makes it and "
                         "name it under `families` in datasets.yaml")  # fmt: skip
    return {"id": id, "arguments": dict(arguments),
            "limit": limit if type(limit) is int and limit > 0 else None}  # fmt: skip


def _in_id(name: Any) -> Said:
    words = name.split("/") if isinstance(name, str) else []
    quality = _VERSION.sub("", words[-1]) if words else ""
    if quality not in QUALITY_CODES:
        quality = ""
    if len(words) != 4 or words[0] != "mpdt" or words[1] not in FAMILIES:
        return Said(quality=quality, by="its dataset_id")
    tasks = {safe(task.name): task.name for task in FAMILIES[words[1]].tasks}
    return Said(words[1], tasks.get(words[2], words[2]), quality, by="its dataset_id")


def _in_env(text: Any, family: Family) -> Said:
    try:
        arguments = decode_json(text)["kwargs"]
    except (TypeError, ValueError, KeyError):
        return Said()
    if not isinstance(arguments, Mapping):
        return Said()
    if arguments.get("family") in FAMILIES:
        found = Said.of({key: arguments.get(key) for key in ("family", "task")}, "its env_spec")
        return found
    env = arguments.get("env_name")
    task = _VERSION.sub("", env) if isinstance(env, str) else ""
    known = "metaworld" in family.packages and task in {one.name for one in family.tasks}
    return Said(task=task, by="its env_spec") if known else Said()


def _in_manifest(text: Any) -> Said:
    try:
        header = decode_json(text)["header"]
    except (TypeError, ValueError, KeyError):
        return Said()
    if not isinstance(header, Mapping):
        return Said()
    return Said.of({key: header.get(key) for key in ("family", "license")}, "its manifest")
