"""Ranges of settings, checked when a settings object is made. NaN is inside none of them."""

from __future__ import annotations

import math

from mpdt.errors import UsageError


def check_at_least(where: str, value: float, least: float) -> None:
    """Raises: UsageError unless `value` is a finite number of at least `least`."""
    if not (math.isfinite(value) and value >= least):
        raise UsageError("setting out of range", where=where, expected=f"at least {least}",
                         found=str(value))  # fmt: skip


def check_above_zero(where: str, value: float) -> None:
    """Raises: UsageError unless `value` is a finite number above 0."""
    if not (math.isfinite(value) and value > 0):
        raise UsageError("setting out of range", where=where, expected="above 0",
                         found=str(value))  # fmt: skip
