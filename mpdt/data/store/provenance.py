"""Which software and which kind of machine made a file; never who, where or when."""

from __future__ import annotations

import platform
from pathlib import Path

import h5py
import numpy as np

from mpdt.version import installed

_PACKAGES = ("mpdt", "numpy", "h5py", "mujoco", "gymnasium", "metaworld", "torch")

WEIGHTS = "behaviour weights"
"""Beside the packages of a file: SHA-256 of the weights that acted, if mpdt does not ship them."""


def packages() -> dict[str, str]:
    """Versions of what decides the bytes of a dataset; a package not installed is left out."""
    python = {"python": platform.python_version(), "hdf5": h5py.version.hdf5_version}
    return python | installed(_PACKAGES)


def machine() -> dict[str, str]:
    """OS, CPU architecture and type, BLAS build. No host or user name, path or time."""
    blas = np.show_config(mode="dicts")["Build Dependencies"]["blas"]
    return {
        "os": platform.system(),
        "arch": platform.machine(),
        "cpu": _cpu_type(),
        "blas": f"{blas.get('name', 'unknown')} {blas.get('version', '')}".strip(),
    }


def _cpu_type() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # not Linux
        return platform.processor() or "unknown"
    for line in lines:
        key, _, value = line.partition(":")
        if key.strip() == "model name":
            return value.strip()
    return "unknown"
