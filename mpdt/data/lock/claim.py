"""Claim: what a raised version says about the data, and which version a change calls for.

    1.0.0 -> 1.0.1   patch   the data read is the same (a license, a reference)
    1.0.0 -> 1.1.0   minor   every old episode is still there, others were added
    1.0.0 -> 2.0.0   major   anything

`1.0.0-rc1` promises nothing, so anything may follow it. What stands behind `+` is no version.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any


class Claim(Enum):
    """How a version relates to the one before it."""

    SAME = "the same version"
    BACK = "an older version"
    PATCH = "patch"
    MINOR = "minor"
    MAJOR = "major"


def claim_of(old: str, new: str) -> Claim:
    """What going from version `old` to `new` claims; both are SemVer as the spec checks it."""
    before, after = _core(old), _core(new)
    if after < before:
        return Claim.BACK
    if _prerelease(old):
        return Claim.SAME if old.partition("+")[0] == new.partition("+")[0] else Claim.MAJOR
    if after == before:
        return Claim.BACK if _prerelease(new) else Claim.SAME
    if after[0] > before[0]:
        return Claim.MAJOR
    return Claim.MINOR if after[1] > before[1] else Claim.PATCH


def next_version(old: str, old_spec: Mapping[str, Any], new_spec: Mapping[str, Any]) -> str:
    """The smallest version that a change of spec may honestly claim, before it was collected."""
    major, minor, patch = _core(old)
    _, plus, build = old.partition("+")
    changed = {key for key in {*old_spec, *new_spec} if old_spec.get(key) != new_spec.get(key)}
    if changed <= {"license", "reference", "version"}:
        return f"{major}.{minor}.{patch + 1}{plus}{build}"
    if changed <= {"license", "reference", "version", "episodes", "tasks", "tta"} and all(
        _grows(old_spec.get(key), new_spec.get(key)) for key in ("episodes", "tasks", "tta")
    ):
        return f"{major}.{minor + 1}.0{plus}{build}"
    return f"{major + 1}.0.0{plus}{build}"


def _grows(old: Any, new: Any) -> bool:
    if isinstance(old, dict) and isinstance(new, dict):
        return all(key in new and _grows(value, new[key]) for key, value in old.items())
    if isinstance(old, list | tuple):
        return new == "all" or (isinstance(new, list | tuple) and set(old) <= set(new))
    if isinstance(old, int) and isinstance(new, int):
        return new >= old
    return bool(old == new)


def _core(version: str) -> tuple[int, int, int]:
    major, minor, rest = version.split(".", 2)
    digits = rest[: len(rest) - len(rest.lstrip("0123456789"))]
    return int(major), int(minor), int(digits)


def _prerelease(version: str) -> bool:
    return "-" in version.partition("+")[0]
