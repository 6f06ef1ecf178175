"""The machine a benchmark ran on: its class, and how busy others kept it meanwhile.

    watch = Watch()              before the work
    watch.others()               processors that others used since, on average: 0.03

Targets hold for a class, and nobody is judged on a machine that others use: what is slow there may
be slow because of them.
"""

from __future__ import annotations

import os
import platform
import time
from pathlib import Path
from typing import Any

MOST = 0.1
"""Of the machine that others may use; more is a busy machine."""
LOOK_S = 1.5  # how long is looked before the work
BFLOAT16 = {"avx512_bf16", "amx_bf16"}  # the instructions that mpdt.model.language asks for


def cores() -> int:
    return len(os.sched_getaffinity(0))


def describe() -> dict[str, Any]:
    """What the numbers depend on beside the code; never a host name."""
    names = _of("/proc/cpuinfo", "model name")
    memory = [int(words.split()[0]) for words in _of("/proc/meminfo", "MemTotal")]
    return {"cpu": names[0] if names else platform.machine(), "cores": cores(),
            "physical": _physical(), "bfloat16": has_bfloat16(),
            "memory_gib": round(sum(memory) / 2**20, 1), "system": platform.system(),
            "load": round(os.getloadavg()[0], 2)}  # fmt: skip


def has_bfloat16() -> bool:
    """Whether the processor multiplies it, told without importing torch."""
    return any(BFLOAT16 & set(flags.split()) for flags in _of("/proc/cpuinfo", "flags")[:1])


class Watch:
    """Counts the processor time that neither this process nor its children took."""

    def __init__(self) -> None:
        self._began, self._busy, self._own = time.monotonic(), _busy_s(), _own_s()

    def others(self) -> float | None:
        """Share of the machine that others had since the beginning; None where nobody tells.

        What a hypervisor gives to other machines counts as well.
        """
        busy = _busy_s()
        if busy is None or self._busy is None:
            return None
        passed = (time.monotonic() - self._began) * (os.cpu_count() or 1)
        return max(0.0, (busy - self._busy - (_own_s() - self._own)) / max(passed, 1e-9))


def others_now() -> float | None:
    """As `Watch.others`, over a moment in which this process does nothing."""
    watch = Watch()
    time.sleep(LOOK_S)
    return watch.others()


def _busy_s() -> float | None:
    """Seconds in which a processor did something, of all of them together."""
    lines = _lines("/proc/stat")
    if not lines:
        return None
    user, nice, system, _, _, irq, softirq, steal = map(int, lines[0].split()[1:9])
    return (user + nice + system + irq + softirq + steal) / os.sysconf("SC_CLK_TCK")


def _own_s() -> float:
    """Seconds of this process, of children it waited for, and of those that still live."""
    own = sum(os.times()[:4])
    children: dict[int, list[tuple[int, float]]] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            number, rest = path.read_text().split(" ", 1)
        except (OSError, UnicodeDecodeError):  # it ended, or its name is no text
            continue
        fields = rest.rpartition(")")[2].split()
        spent = sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
        children.setdefault(int(fields[1]), []).append((int(number), spent))
    waiting = [os.getpid()]
    while waiting:
        for number, spent in children.get(waiting.pop(), ()):
            own += spent
            waiting.append(number)
    return own


def _physical() -> int:
    """Cores whose threads these are; two threads of one core share its arithmetic."""
    found = set()
    for number in os.sched_getaffinity(0):
        path = f"/sys/devices/system/cpu/cpu{number}/topology/thread_siblings_list"
        found.add((_lines(path) or [str(number)])[0])
    return len(found)


def _of(path: str, name: str) -> list[str]:
    """What stands behind `name:` in each such line."""
    return [line.partition(":")[2].strip() for line in _lines(path)
            if line.partition(":")[0].strip() == name]  # fmt: skip


def _lines(path: str) -> list[str]:
    return Path(path).read_text().splitlines() if Path(path).exists() else []
