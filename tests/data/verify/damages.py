"""Ways to change tiny.h5, and how to read what verify says of it.

Task forward holds episodes 0-15 (random 0-3, medium 4-7, expert 8-11, history 12-15), backward
16-31; five steps each, so episode i has steps 5i to 5i+4 and observations 6i to 6i+5.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import Report

Apply = Callable[..., Path]


def outcomes(report: Report, outcome: Outcome = Outcome.FAIL) -> set[str]:
    return {one.id for one in report.findings if one.outcome is outcome}


def finding(report: Report, id: str) -> Any:
    return next(one for one in report.findings if one.id == id)


def put(path: str, key: Any, value: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file[path][key] = value

    change.__name__ = path
    return change


def flip(file: h5py.File) -> None:
    bits = file["steps/observations"][33].view("<u4")
    bits[4] ^= 1
    file["steps/observations"][33] = bits.view("<f4")


def swap_tiers(file: h5py.File) -> None:
    file["episodes/quality"][0:4], file["episodes/quality"][8:12] = 2, 0
    file["episodes/progress"][0:4], file["episodes/progress"][8:12] = 1, 0


def resum(file: h5py.File) -> None:
    rewards = file["steps/rewards"][:].reshape(32, 5)
    file["episodes/return"][:] = rewards.sum(axis=1, dtype=np.float64)


def pay(file: h5py.File) -> None:
    file["steps/rewards"][7] += 0.001
    resum(file)


def both_flags(file: h5py.File) -> None:
    file["steps/terminations"][39] = True


def copy_episode(source: int, target: int) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        steps = file["steps"]
        rows, to = (slice(5 * i, 5 * i + 5) for i in (source, target))
        steps["observations"][6 * target : 6 * target + 6] = steps["observations"][
            6 * source : 6 * source + 6
        ]
        steps["actions"][to] = steps["actions"][rows]

    return change
