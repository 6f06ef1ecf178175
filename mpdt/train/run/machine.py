"""What the seconds of a run, and the last bits of its numbers, depend on beside the code."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any

import torch

from mpdt.model.language import native_bfloat16

_CPUINFO = Path("/proc/cpuinfo")


def machine() -> dict[str, Any]:
    """Processor, cores that this process may use, whether it multiplies bfloat16 itself, and the
    accelerator or None; never a host name."""
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)),
        "bfloat16": native_bfloat16(),
        "accelerator": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
    }


def _processor() -> str:
    lines = _CPUINFO.read_text().splitlines() if _CPUINFO.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())
