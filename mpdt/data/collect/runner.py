"""BlockRunner: what a worker does with one block: simulate it, keep its part, report its returns.

One copy lives in each worker and keeps the last simulator: building one takes longer than a short
block. Meta-World's blocks are shorter than its rows are cheap: `bundled` says which a worker steps
side by side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from mpdt.data.collect.job import Job
from mpdt.data.collect.parts import PartsFolder
from mpdt.data.collect.plan import Block, Plan
from mpdt.data.episode import Episode
from mpdt.data.sim.batch import BatchEnv
from mpdt.data.sim.play import Acted, run_blocks
from mpdt.data.sim.simulators import make_batch
from mpdt.errors import DataError
from mpdt.seeding import SeedKey

PER_WORKER = 4  # bundles, so that no worker idles for long at the end


def bundled(plan: Plan, blocks: Sequence[Block], workers: int) -> list[tuple[Block, ...]]:
    """Blocks in their order, those together that a worker steps side by side.

    Only where a family says up to how many rows that pays, as Meta-World's do. Not where one policy
    acts in all blocks, as in roll-outs: it knows one set of rows at a time.
    """
    found: list[tuple[Block, ...]] = []
    share = sum(block.rows for block in blocks) // (PER_WORKER * max(1, workers))
    most = 0 if plan.side_by_side else min(plan.family.bundle_rows, share)
    for block in blocks:
        last = found[-1] if found else ()
        rows = block.rows + sum(other.rows for other in last)
        same = last and (last[0].task, last[0].horizon) == (block.task, block.horizon)
        if same and rows <= most:
            found[-1] = (*last, block)
        else:
            found.append((block,))
    return found


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
        return self._keep(block, self.simulate(block))

    def together(self, blocks: Sequence[Block]) -> list[BlockReport]:
        """Run blocks of one task and horizon side by side and write their parts.

        The parts are those of the blocks one by one.
        """
        if len(blocks) == 1:
            return [self(blocks[0])]
        plan = self.job.plan
        env = self._batch(blocks[0], sum(block.rows for block in blocks))
        acted = [self._acted(block, block.keys(plan.family, plan.spec.seed)) for block in blocks]
        done = run_blocks(
            env,
            acted,
            horizon=blocks[0].horizon,
            hidden_columns=plan.family.hidden_columns,
            width=plan.width,
        )
        return [self._keep(block, episodes) for block, episodes in zip(blocks, done, strict=True)]

    def _keep(self, block: Block, episodes: list[Episode]) -> BlockReport:
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
        keys = block.keys(plan.family, plan.spec.seed)
        episodes: list[Episode] = []
        for first in range(0, block.rows, plan.width):
            some = keys[first : first + plan.width]
            (done,) = run_blocks(
                self._batch(block, len(some)),
                [self._acted(block, some)],
                horizon=block.horizon,
                hidden_columns=plan.family.hidden_columns,
                width=plan.width,
            )
            episodes += done
        return episodes

    def _acted(self, block: Block, keys: list[SeedKey]) -> Acted:
        policy, progress = self.job.policy(block)
        return Acted(
            policy,
            keys,
            int(block.quality),
            progress,
            clip=block.kind != "tta",
            goal_keys=self._goal_keys(block, keys),
        )

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
