"""Probe: returns of one task at any mixing rate and horizon, each simulated once.

    record of a rate   row 0  r r r r r r r r     an episode of 500 steps begins with the one
                       row 1  r r r r r r r r     of 200 (same goal, coins and actions), so
                              '--200--'           one record answers for both horizons
                              '----- 500 ----'

All rates of a task are measured on the same goals, coins and uniform actions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from mpdt.data.sim.actors import Policy
from mpdt.data.sim.batch import FloatArray
from mpdt.data.sim.calibration import Measurement
from mpdt.data.sim.mixed import script_policy
from mpdt.data.sim.play import run_block
from mpdt.data.sim.simulators import make_batch
from mpdt.data.sim.trained import OpenedBundle, opened_bundle, trained_policy
from mpdt.data.spec.entry import DatasetSpec
from mpdt.data.spec.family import Family
from mpdt.data.spec.tasks import get_family
from mpdt.seeding import Quality, SeedKey


@dataclass(frozen=True)
class _Record:
    rewards: npt.NDArray[np.float32]  # (T,)
    successes: npt.NDArray[np.bool_]  # (T,)


@dataclass(frozen=True)
class Script:
    """Whose actions are mixed with uniform ones: a script of a family, under simulator options.

    Args:
        noise: standard deviation of what is added to its actions.
        bundle: a trained policy that acts in the place of a script.
    """

    family: Family
    name: str
    env: Mapping[str, float | bool] = field(default_factory=dict)
    noise: float = 0.0
    bundle: OpenedBundle | None = None

    @classmethod
    def of(cls, spec: DatasetSpec) -> Script:
        """The one that acts in an entry's episodes."""
        family = get_family(spec.family)
        if spec.behaviour.bundle:
            return cls(family, "", spec.env, spec.behaviour.noise, opened_bundle(spec))
        assert spec.behaviour.script is not None
        # Where several share their tasks, a calibration does not depend on which of them asks.
        measured = get_family(family.measured_in) if family.measured_in else family
        return cls(measured, spec.behaviour.script, spec.env, spec.behaviour.noise)

    def policy(self, task_name: str, rate: float = 0.0) -> Policy:
        """It acting on a task."""
        task = self.family.task(task_name)
        if self.bundle is not None:
            return trained_policy(self.family, self.bundle, task, rate, noise=self.noise)
        return script_policy(self.family, self.name, task, rate, noise=self.noise)


class Probe:
    """Plays episodes of one task and keeps their rewards, so that nothing is played twice."""

    def __init__(self, script: Script, task_name: str, seed: int) -> None:
        self.script, self._family = script, script.family
        self.task = self._family.task(task_name)
        self.seed = seed
        self._records: dict[float, dict[int, _Record]] = {}

    def outcomes(
        self, rate: float, horizon: int, num_episodes: int
    ) -> tuple[FloatArray, FloatArray]:
        """Returns and successes (0 or 1) of the first `num_episodes` episodes, (N,) each."""
        records = self._records.setdefault(rate, {})
        missing = [
            row for row in range(num_episodes)
            if row not in records or len(records[row].rewards) < horizon
        ]  # fmt: skip
        if missing:
            records.update(zip(missing, self._play(rate, horizon, missing), strict=True))
        chosen = [records[row] for row in range(num_episodes)]
        returns = [record.rewards[:horizon].sum(dtype=np.float64) for record in chosen]
        successes = [float(record.successes[:horizon].any()) for record in chosen]
        return np.array(returns), np.array(successes)

    def _play(self, rate: float, horizon: int, rows: list[int]) -> Iterator[_Record]:
        first = SeedKey(self.seed, self._family.id, self.task.index, Quality.CALIBRATION, 0, 0)
        keys = [first.at_row(row) for row in rows]
        env = make_batch(self._family, [self.task] * len(rows), self.script.env)
        policy = self.script.policy(self.task.name, rate)
        for episode in run_block(env, policy, keys, horizon=horizon, quality=-1, progress=-1.0):
            never = np.zeros(episode.length, np.bool_)  # where the simulator tells of none
            yield _Record(
                episode.rewards, never if episode.successes is None else episode.successes
            )


class Gauge:
    """Levels of one task at one horizon: 0 = uniform actions, 1 = the script alone.

    Args:
        portion: episodes are played in portions of this size, at most `portions` of them,
            until what is asked for is known to `error` (standard error of the level).
    """

    def __init__(
        self, probe: Probe, horizon: int, *, portion: int, portions: int, error: float
    ) -> None:
        self._probe, self._horizon = probe, horizon
        self._portion, self._portions, self._error = portion, portions, error
        self.low, self.span = 0.0, 1.0
        self._ends: dict[float, int] = {}  # episodes behind levels 0 and 1
        self._rescale(portion, portion)
        if self.span > 0:  # the span decides how many episodes are enough
            self._rescale(self._enough(1.0), self._enough(0.0))

    def measure(self, rate: float, num_episodes: int | None = None) -> Measurement:
        """Level of a rate, of so many episodes; None: until it is known to `error`.

        Rates 1 and 0 answer with the episodes that make the scale: exactly 0 and 1.
        """
        if num_episodes is None:
            num_episodes = self._ends.get(rate) or self._enough(rate)
        returns, successes = self._probe.outcomes(rate, self._horizon, num_episodes)
        return Measurement(
            rate=rate,
            episodes=num_episodes,
            mean_return=round(float(returns.mean()), 3),
            success=round(float(successes.mean()), 4),
            level=round(float((returns.mean() - self.low) / self.span), 4),
            level_error=round(self._level_error(returns), 4),
        )

    def judge(self, rate: float, close: float) -> Measurement:
        """`measure`, but stops once the level is two standard errors from within `close` of 0.5."""
        for portions in range(1, self._portions + 1):
            found = self.measure(rate, portions * self._portion)
            off = abs(found.level - 0.5)
            if found.level_error <= self._error or off > close + 2 * found.level_error:
                break
        return found

    def _enough(self, rate: float) -> int:
        for portions in range(1, self._portions + 1):
            num_episodes = portions * self._portion
            returns, _ = self._probe.outcomes(rate, self._horizon, num_episodes)
            if self._level_error(returns) <= self._error:
                break
        return num_episodes

    def _level_error(self, returns: FloatArray) -> float:
        return float(returns.std(ddof=1) / self.span / np.sqrt(len(returns)))

    def _rescale(self, num_random: int, num_script: int) -> None:
        self._ends = {1.0: num_random, 0.0: num_script}
        self.low = float(self._probe.outcomes(1.0, self._horizon, num_random)[0].mean())
        high = float(self._probe.outcomes(0.0, self._horizon, num_script)[0].mean())
        self.span = high - self.low
