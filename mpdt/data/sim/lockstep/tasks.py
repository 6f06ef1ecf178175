"""The rules of Meta-World's 50 tasks, by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from mpdt.data.sim.lockstep.hinges import HINGES
from mpdt.data.sim.lockstep.picks import PICKS
from mpdt.data.sim.lockstep.presses import PRESSES
from mpdt.data.sim.lockstep.pushes import PUSHES
from mpdt.data.sim.lockstep.scene import Rules
from mpdt.data.sim.lockstep.tools import TOOLS

RULES: Mapping[str, Rules] = MappingProxyType(PRESSES | HINGES | PUSHES | PICKS | TOOLS)
