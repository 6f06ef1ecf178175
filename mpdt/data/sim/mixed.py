"""The policy of a family's own script: its actions mixed with uniform ones.

The same rule as Meta-World's (`scripted.py`): with chance `mix_rate` per step a uniform action
instead, coins from stream POLICY, and the uniform actions those of `UniformPolicy`. The script's
own actions may get Gaussian noise, stream NOISE: one that is a function of what it sees would
repeat itself wherever every episode starts at the same place.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mpdt.data.episode import PolicyInfo
from mpdt.data.sim.actors import (
    FloatArray,
    Observations,
    Policy,
    Rewards,
    Rows,
    definition_hash,
    uniform_actions,
)
from mpdt.data.spec.family import Family, Task, resolve
from mpdt.errors import MpdtError, SimulatorError
from mpdt.seeding import Stream


def script_policy(
    family: Family,
    script: str,
    task: Task,
    rate: float,
    rung: int = -1,
    level: float = -1.0,
    noise: float = 0.0,
) -> Policy:
    """A script of a family, with chance `rate` per step a uniform action instead.

    Args:
        rung, level: what to record about it (see PolicyInfo); -1 = unknown.
        noise: standard deviation of what is added to its actions; 0 for a family with `scripted`.
    """
    if family.scripted is None:
        return mixed_policy(family, script, task, rate, rung, level, noise)
    policy: Policy = resolve(family.scripted)(family, script, task, rate, rung, level)
    return policy


def mixed_policy(
    family: Family,
    script: str,
    task: Task,
    rate: float,
    rung: int,
    level: float,
    noise: float = 0.0,
) -> MixedPolicy:
    """The policy of one rung, as `Family.scripted` makes it where a family has none."""
    definition: dict[str, object] = {
        "kind": "script", "family": family.name, "version": family.version, "script": script,
        "task": task.name, "mix_rate": float(rate),
    }  # fmt: skip
    if noise:  # without, the hash of before there was any
        definition["noise"] = float(noise)
    name = f"{script}+u{rate:.2f}" if rate else script
    info = PolicyInfo(definition_hash(definition), task.index, rung, level, -1, rate, name)
    return MixedPolicy(family, script, info, noise)


class MixedPolicy:
    """A script's actions, with chance `info.mix_rate` per step a uniform one instead.

    What the script answers is part of the family's version, and so of this policy's hash.

    Args:
        noise: standard deviation of what is added to the script's actions, in their own unit.
    """

    def __init__(self, family: Family, script: str, info: PolicyInfo, noise: float = 0.0) -> None:
        self.info, self._noise_std = info, noise
        self._family, self._script = family, script
        self._goals = np.zeros((0, 0))
        self._coins: npt.NDArray[np.bool_] | None = None
        self._uniform: FloatArray | None = None
        self._noise: FloatArray | None = None

    def begin(self, rows: Rows) -> None:
        family = self._family
        coins = [key.generator(Stream.POLICY).random(rows.horizon) for key in rows.keys]
        self._coins = np.stack(coins) < self.info.mix_rate
        self._uniform = uniform_actions(
            rows.keys, rows.horizon, family.action_size, family.action_low, family.action_high
        )
        self._goals = np.array(rows.goals)
        if self._noise_std:
            shape = (rows.horizon, family.action_size)
            draws = [key.generator(Stream.NOISE).standard_normal(shape) for key in rows.keys]
            self._noise = self._noise_std * np.stack(draws)

    def act(
        self, step: int, observations: Observations, rewards: Rewards | None = None
    ) -> FloatArray:
        assert self._coins is not None and self._uniform is not None, "begin() comes first"
        # Asked for every row at every step, so that a row's answer does not depend on the others'
        # coins where a script computes in batches.
        found = self._answer(step, observations.astype(np.float64), rewards)
        if self._noise is not None:
            found = found + self._noise[:, step]
        return np.where(self._coins[:, step, None], self._uniform[:, step], found)

    def _answer(self, step: int, observations: FloatArray, rewards: Rewards | None) -> FloatArray:
        """Raises: SimulatorError for whatever the script does wrong."""
        where = f"{self._family.module or self._family.name}, script {self._script}, step {step}"
        try:
            # Copies: what a script writes into its arguments is its own.
            answer = resolve(self._family.scripts[self._script])(observations, self._goals.copy())
            actions = np.array(answer, dtype=np.float64)
        except MpdtError:
            raise
        except (Exception, SystemExit) as error:
            found = f"{type(error).__name__}: {error}"[:200]
            raise SimulatorError("the script raised", where=where, found=found) from error
        wanted = (len(observations), self._family.action_size)
        if actions.shape != wanted or not np.isfinite(actions).all():
            found = str(actions.shape) if actions.shape != wanted else "numbers that are not finite"
            raise SimulatorError("the script's actions are none", where=where,
                                 expected=f"{wanted}, finite", found=found)  # fmt: skip
        return actions
