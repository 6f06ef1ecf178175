"""A bundle as the expert of an entry of datasets.yaml; `mpdt.data.sim.trained` names it as text.

A task acts behind its own prompt, one that has none behind that of the set `start`. Acts on one
thread, as in every worker: threads may change last bits, and a robot amplifies them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import torch
from numpy.typing import NDArray

from mpdt.errors import SpecError, unknown_name
from mpdt.train.bundle.acting import ActingPolicy
from mpdt.train.bundle.build import Bundle
from mpdt.train.bundle.format import OWN, seal
from mpdt.train.bundle.read import read_bundle
from mpdt.train.bundle.select import policy_of_bundle, refuse_left_out
from mpdt.train.run.load import bundle_folder


def open_expert(folder: Path, family: str, start: str | None, where: str) -> BundleExpert:
    """The policy in a folder, or in that of a run.

    Args:
        where: what asks for it, for messages.
    Raises: as `read_bundle`; SpecError for a policy of another family; UsageError for a set of
        prompts that it has not.
    """
    bundle = read_bundle(bundle_folder(str(folder)))
    if bundle.family.name != family:
        raise SpecError("the policy was trained for another family", where=where, expected=family,
                        found=f"{bundle.family.name} in {folder}")  # fmt: skip
    refuse_left_out(bundle.config, start)
    sets = [one.name for one in bundle.config.prompts]
    if start is not None and start not in sets:
        raise unknown_name("start", start, sets, where=where)
    return BundleExpert(bundle, start)


@dataclass(eq=False)
class BundleExpert:
    """See `mpdt.data.sim.trained.Opened`."""

    bundle: Bundle
    start: str | None
    _prints: dict[str, bytes] = field(default_factory=dict)

    @property
    def seal(self) -> str:
        return seal(msgspec.to_builtins(self.bundle.config))

    @property
    def name(self) -> str:
        return self.bundle.config.name

    def fingerprint(self, task: str) -> bytes:
        """Raises: KeyError for a task without a prompt, which says which sets have one."""
        chosen = self._set(task)
        if chosen not in self._prints:  # it is over all tasks of the set
            self._prints[chosen] = policy_of_bundle(self.bundle, task, chosen).fingerprint
        return self._prints[chosen]

    def acting(self, task: str, rows: int) -> OnOneThread:
        policy = policy_of_bundle(self.bundle, task, self._set(task))
        policy.reset([task] * rows)
        return OnOneThread(policy)

    def _set(self, task: str) -> str:
        having = [one.name for one in self.bundle.config.prompts if task in one.tasks]
        for name in (OWN, self.start):
            if name in having:
                return name
        raise KeyError(f"prompts in {', '.join(having)}" if having else "none in any set")


@dataclass(frozen=True, eq=False)
class OnOneThread:
    """A policy that leaves torch's threads as they were."""

    policy: ActingPolicy

    def act_batch(self, observations: Any, rewards: Any) -> NDArray[Any]:
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            return self.policy.act_batch(observations, rewards)
        finally:
            torch.set_num_threads(before)

    def acted(self, actions: Any) -> None:
        self.policy.acted(actions)
