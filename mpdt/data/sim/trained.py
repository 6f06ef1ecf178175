"""A policy of `mpdt-train` as the expert of an entry: `behaviour: {bundle: FOLDER}`.

    entry -> OPENED_BY opens the folder -> every task behind its own prompt, or that of `start`
          -> hashes of who acts; workers open it again, and it has to be the same

What trains stands above the data and is never imported from here. So the opener is named as text,
as a family names its simulator, and imported when an entry asks for it (decision 0044).

Used by ladder.py and probe.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy.typing as npt

from mpdt.data.episode import PolicyInfo
from mpdt.data.sim.actors import FloatArray, Observations, Policy, Rewards, Rows, definition_hash
from mpdt.data.sim.ladder import MixedLadder
from mpdt.data.sim.mixed import MixedPolicy
from mpdt.data.spec.entry import DatasetSpec
from mpdt.data.spec.family import Family, Task, resolve
from mpdt.errors import DataError, SpecError

OPENED_BY = "mpdt.train.rollout.expert:open_expert"


class Acting(Protocol):
    """A trained policy on rows of one task; it keeps what they have seen."""

    def act_batch(self, observations: Any, rewards: Any) -> npt.NDArray[Any]:
        """(B, D) and (B,) paid for the action before, or None at first -> (B, A)."""
        ...

    def acted(self, actions: Any) -> None:
        """What was done in the place of the answer."""
        ...


class Opened(Protocol):
    """What `OPENED_BY` gives.

    seal: SHA-256 over everything in the folder, in hex; name: what the policy is called.
    """

    @property
    def seal(self) -> str: ...

    @property
    def name(self) -> str: ...

    def fingerprint(self, task: str) -> bytes:
        """32 bytes of what decides its actions on a task."""
        ...

    def acting(self, task: str, rows: int) -> Acting:
        """It on so many rows of a task, all at their first step."""
        ...


@dataclass(eq=False)
class OpenedBundle:
    """A folder that was opened here, and is opened again in every process that acts.

    Args:
        prints: fingerprint of the policy by task name.
        rates: name of the files with its mixing rates.
    """

    folder: Path
    family: str
    start: str | None
    seal: str
    name: str
    prints: Mapping[str, bytes]
    _opened: Opened | None = field(default=None, repr=False)

    @property
    def rates(self) -> str:
        return f"{self.family}.{self.seal[:12]}"

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_opened": None}

    def acting(self, task: str, rows: int) -> Acting:
        """Raises: as `opened_bundle`; DataError for another policy than was opened first."""
        if self._opened is None:
            opened = _open(self.folder, self.family, self.start)
            if opened.seal != self.seal or opened.fingerprint(task) != self.prints[task]:
                raise DataError("another policy took its place meanwhile", where=str(self.folder),
                                expected=self.seal[:12], found=opened.seal[:12],
                                hint="the same command begins anew with it")  # fmt: skip
            self._opened = opened
        return self._opened.acting(task, rows)


def opened_bundle(spec: DatasetSpec) -> OpenedBundle:
    """The policy that an entry names.

    Raises: MissingFileError or FormatError for a folder that holds none; SpecError for one of
        another family, and for tasks that it has no prompt for.
    """
    behaviour = spec.behaviour
    assert behaviour.bundle
    folder, start = Path(behaviour.bundle).absolute(), behaviour.start or None
    opened = _open(folder, spec.family, start, f"{spec.name}.behaviour")
    names = [task.name for task in spec.resolve_tasks()]
    prints = {}
    for name in names:
        try:
            prints[name] = opened.fingerprint(name)
        except KeyError as error:
            raise SpecError(
                f"the policy has no prompt for the task {name}", where=f"{spec.name}.behaviour",
                expected=f"one of its own{f', or of the set {start}' if start else ''}",
                found=error.args[0],
                hint="behaviour.start names a set of prompts for tasks without an own one; `tasks` "
                "leaves them out",
            ) from error  # fmt: skip
    return OpenedBundle(folder, spec.family, start, opened.seal, opened.name, prints, opened)


def _open(folder: Path, family: str, start: str | None, where: str = "") -> Opened:
    opened: Opened = resolve(OPENED_BY)(folder, family, start, where or str(folder))
    return opened


def trained_policy(
    family: Family,
    bundle: OpenedBundle,
    task: Task,
    rate: float,
    rung: int = -1,
    level: float = -1.0,
    noise: float = 0.0,
) -> Policy:
    """The policy of a bundle on a task, with chance `rate` per step a uniform action instead.

    Args: as `script_policy`.
    """
    definition: dict[str, object] = {
        "kind": "bundle", "policy": bundle.prints[task.name].hex(), "mix_rate": float(rate),
    }  # fmt: skip
    if noise:
        definition["noise"] = float(noise)
    name = f"{bundle.name}+u{rate:.2f}" if rate else bundle.name
    info = PolicyInfo(definition_hash(definition), task.index, rung, level, -1, rate, name)
    return TrainedPolicy(family, bundle, task, info, noise)


class TrainedPolicy(MixedPolicy):
    """It sees what the data shows, is told what it is paid, and what was done in its place."""

    def __init__(
        self, family: Family, bundle: OpenedBundle, task: Task, info: PolicyInfo, noise: float
    ) -> None:
        super().__init__(family, "", info, noise)
        self._bundle, self._task = bundle, task
        self._acting: Acting | None = None

    def begin(self, rows: Rows) -> None:
        super().begin(rows)
        # One of its own: other blocks may act beside this one.
        self._acting = self._bundle.acting(self._task.name, len(rows.keys))

    def act(
        self, step: int, observations: Observations, rewards: Rewards | None = None
    ) -> FloatArray:
        actions = super().act(step, observations, rewards)
        if self._acting is not None and (self.info.mix_rate or self._noise is not None):
            self._acting.acted(actions)
        return actions

    def _answer(self, step: int, observations: FloatArray, rewards: Rewards | None) -> FloatArray:
        assert self._acting is not None, "begin() comes first"
        answer: FloatArray = self._acting.act_batch(observations, rewards).astype(float)
        return answer


class BundleLadder(MixedLadder):
    """A trained policy. Raises: as `MixedLadder` and `opened_bundle`."""

    def __init__(self, spec: DatasetSpec, folder: Path | None = None) -> None:
        self._bundle = opened_bundle(spec)
        self.weights = self._bundle.seal
        super().__init__(spec, self._bundle.rates, "policy", folder)

    @property
    def notice(self) -> str:
        who = (
            f"behaviour: a policy of mpdt-train, {self._bundle.folder}, SHA-256 {self.weights[:16]}"
        )
        return "; ".join(filter(None, [who, super().notice]))

    def _expert(self, task: Task, rate: float, rung: int, level: float) -> Policy:
        noise = self._spec.behaviour.noise
        return trained_policy(self._family, self._bundle, task, rate, rung, level, noise)
