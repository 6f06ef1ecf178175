"""Portions: some episodes of one reference policy on one task, played by a worker.

    portion   (task, policy, horizons, first, rows)   ->   score by horizon

An episode of 500 steps begins with the one of 200, so one play answers for both horizons.
Seeds depend on the row only: a portion is the same whoever plays it, and whenever.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
import numpy.typing as npt

from mpdt.data.episode import Episode
from mpdt.data.sim.actors import ConstantPolicy, Policy, UniformPolicy, ZeroPolicy
from mpdt.data.sim.batch import BatchEnv
from mpdt.data.sim.constants import constant_actions
from mpdt.data.sim.ladder import Ladder, load_ladder
from mpdt.data.sim.play import run_block
from mpdt.data.sim.record import Score, constant_names
from mpdt.data.sim.simulators import make_batch
from mpdt.data.spec.entry import DatasetSpec, EpisodeCounts
from mpdt.data.spec.tasks import Task, get_family
from mpdt.seeding import Quality, SeedKey

ROWS = 40  # most rows of a portion; a network is evaluated at this width
QUALITIES = {
    "zero": Quality.REFERENCE_ZERO,
    "random": Quality.REFERENCE_RANDOM,
    "expert": Quality.REFERENCE_EXPERT,
    "constant": Quality.REFERENCE_CONSTANT,
}


def kind_of(policy: str) -> str:
    """zero, random, constant or expert, from a policy's name in the record."""
    return policy.partition(":")[0].rstrip("+-0123456789")


@dataclass(frozen=True)
class Portion:
    """Episodes `first` to `first + rows - 1`; `task` is one of the spec's."""

    task: Task
    policy: str
    horizons: tuple[int, ...]
    first: int
    rows: int

    @property
    def steps(self) -> int:
        """Env steps at most."""
        return self.rows * max(self.horizons)


def score_of(
    returns: npt.NDArray[np.float64], successes: npt.NDArray[np.bool_] | None = None
) -> Score:
    """Of the returns (N,) and successes (N,) of at least two episodes."""
    success = None if successes is None else round(float(successes.mean()), 9)
    mean, std = float(returns.mean()), float(returns.std(ddof=1))
    return Score(len(returns), round(mean, 6), round(std, 6), success)


def expert_ladder(spec: DatasetSpec) -> Ladder:
    """The ladder of a spec that collects no medium, which would need a calibration."""
    return load_ladder(msgspec.structs.replace(spec, episodes=EpisodeCounts(expert=1)))


class Player:
    """Callable on portions; picklable before its first call. Keeps its simulator and ladder."""

    def __init__(self, spec: DatasetSpec, seed: int) -> None:
        self.spec, self.seed = spec, seed
        family = get_family(spec.family)
        # Where several share their tasks, numbers do not depend on which of them asks.
        self._family = get_family(family.measured_in) if family.measured_in else family
        self._ladder: Ladder | None = None
        self._env: tuple[tuple[int, int], BatchEnv] | None = None

    def __call__(self, portion: Portion) -> tuple[Portion, dict[int, Score]]:
        """The portion and its score at each of its horizons."""
        episodes = self.episodes(portion)

        def score(horizon: int) -> Score:
            returns = [e.rewards[:horizon].sum(dtype=np.float64) for e in episodes]
            wins = [e.successes[:horizon].any() for e in episodes if e.successes is not None]
            return score_of(np.array(returns), np.array(wins) if wins else None)

        return portion, {horizon: score(horizon) for horizon in portion.horizons}

    def episodes(self, portion: Portion) -> list[Episode]:
        """The episodes of a portion, as long as its longest horizon, in order of their rows."""
        family = self._family
        task, quality = family.task(portion.task.name), QUALITIES[kind_of(portion.policy)]
        first = SeedKey(self.seed, family.id, task.index, quality, 0, 0)
        keys = [first.at_row(portion.first + row) for row in range(portion.rows)]
        return run_block(
            self._batch(task, len(keys)),
            self._policy(portion),
            keys,
            horizon=max(portion.horizons),
            quality=-1,
            progress=-1.0,
            width=ROWS,
        )

    def _batch(self, task: Task, rows: int) -> BatchEnv:
        wanted = (task.index, rows)
        if self._env is None or self._env[0] != wanted:
            self._env = (wanted, make_batch(self._family, [task] * rows, self.spec.env))
        return self._env[1]

    def _policy(self, portion: Portion) -> Policy:
        family, kind = self._family, kind_of(portion.policy)
        size = family.action_size
        if kind == "zero":
            return ZeroPolicy(size)
        if kind == "random":
            return UniformPolicy(size, family.action_low, family.action_high)
        if kind == "constant":
            number = constant_names(size).index(portion.policy)
            return ConstantPolicy(constant_actions(size)[number])
        if self._ladder is None:
            self._ladder = expert_ladder(self.spec)
        return self._ladder.policy(portion.task, "expert", 0)[0]
