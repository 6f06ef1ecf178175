"""The scripted policy: Meta-World's experts mixed with uniform actions."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import metadata

import numpy as np
import numpy.typing as npt

from mpdt.data.episode import PolicyInfo
from mpdt.data.sim.actors import (
    FloatArray,
    Observations,
    Rewards,
    Rows,
    definition_hash,
    uniform_actions,
)
from mpdt.data.sim.scripts import ACTION_SIZE, Expert, corrections_of
from mpdt.data.spec.family import Family, Task
from mpdt.errors import UsageError
from mpdt.seeding import Stream


def policy_of(
    family: Family, script: str, task: Task, rate: float, rung: int, level: float
) -> ScriptedPolicy:
    """The policy of a Meta-World family's script, as its contract names it."""
    return ScriptedPolicy([task.name], rate, task=task.index, rung=rung, level=level)


class ScriptedPolicy:
    """The scripted expert (scripts.py); with chance `mix_rate` per step a uniform action instead.

        step       0       1       2       3
        coin      .81     .12     .64     .97      stream POLICY, one number per step
        rate .30  script  random  script  script   random where coin < rate
        rate .70  script  random  random  script   a higher rate replaces these and more

    Rate 0 is the script alone, rate 1 exactly `UniformPolicy` (coins are in [0, 1)). Random
    actions are drawn for every step, so those that remain are the same at every rate. Experts
    are functions of one observation, keep no state, and answer within [-1, 1].

    Args:
        task_names: Meta-World task of each row, without "-v3"; one name is that of every row.
        mix_rate: in [0, 1].
        task, rung, level: what to record about it (see PolicyInfo); -1 = unknown.

    Raises: UsageError for a rate outside [0, 1] or a task Meta-World has no script for.
    """

    def __init__(
        self,
        task_names: Sequence[str],
        mix_rate: float = 0.0,
        *,
        task: int = -1,
        rung: int = -1,
        level: float = -1.0,
    ) -> None:
        if not 0.0 <= mix_rate <= 1.0:
            raise UsageError(
                "mixing rate out of range", expected="a number in [0, 1]", found=str(mix_rate)
            )
        self.task_names, self.mix_rate = tuple(task_names), mix_rate
        self._experts: dict[str, Expert] = {}
        self._rows: dict[str, npt.NDArray[np.int64]] = {}
        self._coins: npt.NDArray[np.bool_] | None = None
        self._uniform: FloatArray | None = None
        definition: dict[str, object] = {
            "kind": "script",
            # Rows act independently, so their order is no part of the definition.
            "tasks": sorted(set(task_names)),
            "metaworld": metadata.version("metaworld"),
            "mix_rate": float(mix_rate),
        }
        if corrections := corrections_of(task_names):  # Meta-World's own script keeps its old hash
            definition["corrections"] = corrections
        self.info = PolicyInfo(
            hash=definition_hash(definition),
            task=task,
            rung=rung,
            level=level,
            train_step=-1,
            mix_rate=mix_rate,
            name=f"script+u{mix_rate:.2f}" if mix_rate else "script",
        )

    def begin(self, rows: Rows) -> None:
        assert len(self.task_names) in (1, len(rows.keys)), "one key per row"
        names = np.broadcast_to(np.array(self.task_names), len(rows.keys))
        self._rows = {name: np.flatnonzero(names == name) for name in set(self.task_names)}
        if not self._experts:
            self._experts = {name: Expert(name) for name in self._rows}
        coins = [key.generator(Stream.POLICY).random(rows.horizon) for key in rows.keys]
        self._coins = np.stack(coins) < self.mix_rate
        self._uniform = uniform_actions(rows.keys, rows.horizon, ACTION_SIZE, -1.0, 1.0)

    def act(
        self, step: int, observations: Observations, rewards: Rewards | None = None
    ) -> FloatArray:
        return self.act_all(step, [self], [observations])[0]

    @staticmethod
    def act_all(
        step: int, policies: Sequence[ScriptedPolicy], observations: Sequence[Observations]
    ) -> list[FloatArray]:
        """As `act` of each; the expert of a task sees the rows of all of them at once."""
        found = [policy._drawn(step) for policy in policies]
        for name in dict.fromkeys(name for policy in policies for name in policy._rows):
            asked = [(number, policy._scripted(name, step)) for number, policy in
                     enumerate(policies) if name in policy._rows]  # fmt: skip
            shown = np.concatenate([observations[number][rows] for number, rows in asked])
            if len(shown):
                expert = policies[asked[0][0]]._experts[name]
                answers = expert.act(shown.astype(np.float64, copy=False))
                ends = np.cumsum([len(rows) for _, rows in asked])[:-1]
                for (number, rows), own in zip(asked, np.split(answers, ends), strict=True):
                    found[number][rows] = own
        return found

    def _drawn(self, step: int) -> FloatArray:
        """The uniform actions of a step, (B, 4)."""
        assert self._uniform is not None, "begin() comes first"
        return self._uniform[:, step].copy()

    def _scripted(self, name: str, step: int) -> npt.NDArray[np.int64]:
        """The rows of a task in which the script acts."""
        assert self._coins is not None, "begin() comes first"
        rows = self._rows[name]
        found: npt.NDArray[np.int64] = rows[~self._coins[rows, step]]
        return found
