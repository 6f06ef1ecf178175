"""BlockRunner: what a worker does with one block: simulate it, keep its part, report its returns.

One copy lives in each worker and keeps the last simulator: building one takes longer than a short
block.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from mpdt.data.collect.job import Job
from mpdt.data.collect.parts import PartsFolder
from mpdt.data.collect.plan import Block
from mpdt.data.episode import Episode
from mpdt.data.sim.batch import BatchEnv
from mpdt.data.sim.play import run_block
from mpdt.data.sim.simulators import make_batch
from mpdt.errors import DataError
from mpdt.seeding import SeedKey


@dataclass(frozen=True, eq=False)
class BlockReport:
    """What is known of a finished block without opening its part again.

    Shapes: returns (rows,) float64, summed rewards per episode; `steps` is their total length.
    """

    block: Block
    steps: int
    returns: npt.NDArray[np.float64]


class BlockRunner:
    """Callable on blocks; picklable before its first call."""

    def __init__(self, job: Job, folder: PartsFolder) -> None:
        self.job, self.folder = job, folder
        self._env: tuple[tuple[int, int], BatchEnv] | None = None

    def __call__(self, block: Block) -> BlockReport:
        """Run `block` and write its part.

        Raises: StorageError, DataError (numbers that are not finite), SimulatorError.
        """
        episodes = self.simulate(block)
        part = self.folder.part(block)
        returns = np.array([episode.episode_return for episode in episodes])
        if block.kind == "reference":
            part.save_returns(returns, self.job.actor(block)[0])
        else:
            part.save_episodes(episodes)
        return BlockReport(block, sum(episode.length for episode in episodes), returns)

    def simulate(self, block: Block) -> list[Episode]:
        """The episodes of a block, in order of their rows. A pure function of (spec, block)."""
        plan = self.job.plan
        policy, progress = self.job.policy(block)
        keys = block.keys(plan.family, plan.spec.seed)
        episodes: list[Episode] = []
        for first in range(0, block.rows, plan.width):
            some = keys[first : first + plan.width]
            episodes += run_block(
                self._batch(block, len(some)),
                policy,
                some,
                horizon=block.horizon,
                quality=int(block.quality),
                progress=progress,
                hidden_columns=plan.family.hidden_columns,
                width=plan.width,
                clip=block.kind != "tta",
                goal_keys=self._goal_keys(block, some),
            )
        return episodes

    def _goal_keys(self, block: Block, keys: list[SeedKey]) -> list[SeedKey] | None:
        goals, rows = self.job.spec.goals, self.job.spec.block
        if goals is None or block.kind == "reference":
            return None
        draw = goals.held_out_key if block.unseen_goals else goals.training_key
        return [draw(key, rows) for key in keys]

    def _batch(self, block: Block, rows: int) -> BatchEnv:
        wanted = (block.task.index, rows)
        if self._env is None or self._env[0] != wanted:
            env = make_batch(self.job.plan.family, [block.task] * rows, self.job.spec.env)
            self._env = (wanted, env)
        return self._env[1]


class Gap(Enum):
    """Why a block has to be done."""

    MISSING = "not done yet"
    DAMAGED = "damaged"
    OUTDATED = "somebody else acted"


def report_part(folder: PartsFolder, block: Block, actor: tuple[bytes, float]) -> BlockReport | Gap:
    """The report of a block that is already done, or why it has to be done (again).

    Reads and checks the whole part: a resumed dataset must not differ from a fresh one. A part
    where somebody else acted than `actor` (policy hash, progress) does not count, so after a
    new calibration only the blocks of the rates that changed are done again.
    """
    part = folder.part(block)
    if not part.path.exists():
        return Gap.MISSING
    try:
        if block.kind == "reference":
            returns, policy = part.load_returns()
            return BlockReport(block, 0, returns) if policy == actor[0] else Gap.OUTDATED
        episodes = part.load_episodes()
    except DataError:
        return Gap.DAMAGED
    if any((episode.policy, episode.progress) != actor for episode in episodes):
        return Gap.OUTDATED
    returns = np.array([episode.episode_return for episode in episodes])
    return BlockReport(block, sum(episode.length for episode in episodes), returns)
