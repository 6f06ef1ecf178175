"""Ladder: the rungs of each task, and which of them acts for which quality.

    quality   policy                               progress
    random    uniform actions                      0
    medium    the rung nearest half the level      its place (network) or level (script)
    expert    the last rung                        1
    history   every rung in turn                   rung / (rungs - 1)

A network ladder is one training run (network.py). A script has none: a rung there is the
script with `mix_rate` of its actions replaced by uniform ones, from rate 1 down to rate 0. So it is
with a policy of `mpdt-train` (trained.py).

Used by collect/job.py and portions.py.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from mpdt.data.episode import QUALITY_CODES, PolicyInfo
from mpdt.data.sim.actors import Policy, UniformPolicy
from mpdt.data.sim.calibration import (
    Calibration,
    load_calibrations,
    load_local,
    local_path,
)
from mpdt.data.sim.mixed import script_policy
from mpdt.data.spec.entry import DatasetSpec
from mpdt.data.spec.family import Task
from mpdt.data.spec.tasks import get_family
from mpdt.errors import SpecError, quoted, unknown_name
from mpdt.seeding import HISTORY_STRIDE


class Ladder(Protocol):
    """The policies behind the episodes of one spec."""

    @property
    def num_rungs(self) -> int: ...

    @property
    def notice(self) -> str:
        """What a user should know about where these policies come from, or nothing."""
        ...

    @property
    def weights(self) -> str:
        """SHA-256 of weights of the user's own; empty where mpdt's act, or a script."""
        ...

    def policy(self, task: Task, quality: str, block: int) -> tuple[Policy, float]:
        """Who acts in a block, and its progress in [0, 1].

        `block` is the block number of the seed key; in `history` it holds the rung.
        """
        ...

    def policies(self, tasks: Sequence[Task]) -> list[PolicyInfo]:
        """Every policy `policy` can answer with for these tasks, by task, then by rung."""
        ...


def load_ladder(spec: DatasetSpec, folder: Path | None = None) -> Ladder:
    """The ladder `spec.behaviour` names; calibrations in `folder` (default: here) win.

    Raises: SpecError if the behaviour does not fit the family or has not been calibrated.
    """
    if spec.behaviour.script is not None:
        return ScriptLadder(spec, folder)
    if spec.behaviour.bundle:
        from mpdt.data.sim.trained import BundleLadder  # lazy: it opens the policy

        return BundleLadder(spec, folder)
    from mpdt.data.sim.network import NetworkLadder  # lazy: reads weights, needs safetensors

    return NetworkLadder(spec)


class MixedLadder(ABC):
    """An expert mixed with uniform actions at calibrated rates; whoever it is says `_expert`.

        rung   0     1     2    ..   R-1      history: rates evenly spaced, for every task
        rate   1   1-1/(R-1)    ..    0       medium: the task's calibrated rate, between two

    Args:
        rates: name of the files with its mixing rates.
        kind: what the expert is, for messages.
    Raises: SpecError if the spec asks for `medium` of a task without calibration at its horizon.
    """

    weights = ""

    def __init__(self, spec: DatasetSpec, rates: str, kind: str, folder: Path | None) -> None:
        self._family, self._spec, self._kind = get_family(spec.family), spec, kind
        self._calibrations = load_calibrations(folder, rates)
        self._local, self._local_path = load_local(folder, rates), local_path(folder, rates)
        self.num_rungs = spec.behaviour.rungs
        if spec.episodes.medium:
            for task in spec.resolve_tasks():
                self._calibration(task)

    @property
    def notice(self) -> str:
        """How many tasks take the rate of `medium` from the working folder."""
        tasks = self._spec.resolve_tasks() if self._spec.episodes.medium else ()
        count = sum((task.name, self._spec.horizon) in self._local for task in tasks)
        place = f"./{self._local_path}" if not self._local_path.is_absolute() else self._local_path
        plural = "s" if count != 1 else ""
        return f"mixing rates of {count} task{plural} from {place}" if count else ""

    def policy(self, task: Task, quality: str, block: int) -> tuple[Policy, float]:
        """Who acts in a block of `task`, and its progress; see Ladder."""
        last = self.num_rungs - 1
        if quality == "random":
            return self._uniform(task), 0.0
        if quality == "medium":
            found = self._calibration(task)
            rung = round((1 - found.rate) * last)
            return self._expert(task, found.rate, rung, found.level), found.level
        if quality == "expert":
            return self._expert(task, 0.0, last, 1.0), 1.0
        if quality == "history":
            rung = block // HISTORY_STRIDE
            assert 0 <= rung <= last, "the block number of history holds the rung"
            return self._rung(task, rung), rung / last
        raise unknown_name("quality", quality, QUALITY_CODES)

    def policies(self, tasks: Sequence[Task]) -> list[PolicyInfo]:
        """Rows of /policies: only those the spec's episodes and references can meet."""
        found: dict[tuple[int, bytes], PolicyInfo] = {}
        for task in tasks:
            infos = [self.policy(task, "random", 0)[0].info]
            if self._spec.episodes.history:
                infos += [self._rung(task, rung).info for rung in range(self.num_rungs)]
            if self._spec.episodes.medium:
                infos.append(self.policy(task, "medium", 0)[0].info)
            infos.append(self.policy(task, "expert", 0)[0].info)
            for info in sorted(infos, key=lambda info: (info.rung, -info.mix_rate)):
                found.setdefault((info.task, info.hash), info)
        return list(found.values())

    def _calibration(self, task: Task) -> Calibration:
        horizon = self._spec.horizon
        if (task.name, horizon) not in self._calibrations:
            known = sorted({steps for name, steps in self._calibrations if name == task.name})
            raise SpecError(
                f"'{task.name}' has no calibrated mixing rate for medium",
                where=self._spec.name,
                expected=f"a calibration at horizon {horizon}",
                found=f"horizons {known}" if known else "none",
                hint=f"mpdt-data calibrate {quoted(self._spec.name)}",
            )
        found = self._calibrations[task.name, horizon]
        if found.policy not in ("", self._expert(task, 0.0, -1, -1.0).info.hash.hex()):
            raise SpecError(
                f"the mixing rate of '{task.name}' was calibrated with another {self._kind}",
                where=self._spec.name,
                expected=f"the {self._kind} that there is now",
                found=f"policy {found.policy[:8]}",
                hint=f"mpdt-data calibrate {quoted(self._spec.name)}",
            )
        if dict(found.env) != self._spec.env:
            raise SpecError(
                f"the mixing rate of '{task.name}' was calibrated with other options",
                where=f"{self._spec.name}.env",
                expected=str(dict(found.env)),
                found=str(dict(self._spec.env)),
                hint=f"mpdt-data calibrate {quoted(self._spec.name)}",
            )
        return found

    def _rung(self, task: Task, rung: int) -> Policy:
        last = self.num_rungs - 1
        if rung == 0:
            return self._uniform(task)  # a script at rate 1 acts the same, under another hash
        rate = round(1 - rung / last, 6)
        known = self._calibrations.get((task.name, self._spec.horizon))
        level = known.level_at(rate) if known else -1.0
        return self._expert(task, rate, rung, 1.0 if rung == last else level)

    @abstractmethod
    def _expert(self, task: Task, rate: float, rung: int, level: float) -> Policy:
        """It with chance `rate` per step a uniform action instead."""

    def _uniform(self, task: Task) -> UniformPolicy:
        family = self._family
        policy = UniformPolicy(
            family.action_size, family.action_low, family.action_high, task=task.index
        )
        policy.info = replace(policy.info, mix_rate=1.0)
        return policy


class ScriptLadder(MixedLadder):
    """A family's script. Raises: SpecError also for one that the family does not have."""

    def __init__(self, spec: DatasetSpec, folder: Path | None = None) -> None:
        family = get_family(spec.family)
        assert spec.behaviour.script is not None
        self._script_name = spec.behaviour.script
        if self._script_name not in family.scripts:
            raise SpecError(
                "no such script for this family",
                where=f"{spec.name}.behaviour.script",
                expected=", ".join(family.scripts) or f"a network: {spec.family} has no script",
                found=f"{spec.behaviour.script} in {spec.family}",
            )
        super().__init__(spec, family.rates or family.name, "script", folder)

    def _expert(self, task: Task, rate: float, rung: int, level: float) -> Policy:
        noise = self._spec.behaviour.noise
        return script_policy(self._family, self._script_name, task, rate, rung, level, noise)
