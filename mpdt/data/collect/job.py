"""Job: what one collection makes and who acts in it, found out once per command.

    spec -> ladder -> references on record -> plan

The verb shows the plan, `collect` runs it, and every worker is sent the whole job. So all of them
act with the ladder the plan was made with, also where the working folder has got other mixing
rates meanwhile, and on a node that does not see that folder.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpdt.data.collect.plan import Block, Plan, make_plan
from mpdt.data.episode import PolicyInfo
from mpdt.data.sim.actors import Policy, UniformPolicy, ZeroPolicy
from mpdt.data.sim.ladder import Ladder, load_ladder
from mpdt.data.sim.record import find_records, local_notice
from mpdt.data.spec.entry import DatasetSpec


@dataclass(frozen=True, eq=False)
class Job:
    """A plan with the policies behind its blocks; picklable.

    Args:
        ladder: None where no block needs one: a set of random actions can be added to a file
            whose behaviour is not installed here.
    """

    plan: Plan
    ladder: Ladder | None = None

    @property
    def spec(self) -> DatasetSpec:
        return self.plan.spec

    @property
    def policies(self) -> list[PolicyInfo]:
        """Every policy an episode of the file may name."""
        return self.ladder.policies(self.plan.tasks) if self.ladder else []

    @property
    def notices(self) -> list[str]:
        """What a user should know about where rates and references come from."""
        found = [self.ladder.notice if self.ladder else "", local_notice(self.plan.records)]
        return [notice for notice in found if notice]

    def policy(self, block: Block) -> tuple[Policy, float]:
        """Who acts in a block, and its progress on the ladder."""
        family = self.plan.family
        if block.kind == "tta":
            low, high = family.action_low, family.action_high
            uniform = UniformPolicy(
                family.action_size, low, high, block.action_scale, task=block.task.index
            )
            return uniform, 0.0
        if block.name == "zero":
            return ZeroPolicy(family.action_size, task=block.task.index), 0.0
        assert self.ladder is not None, "only a TTA set is planned without a ladder"
        return self.ladder.policy(block.task, block.name, block.number)

    def actor(self, block: Block) -> tuple[bytes, float]:
        """Hash of who acts in a block, and the progress stored with it."""
        policy, progress = self.policy(block)
        return policy.info.hash, progress


def make_job(spec: DatasetSpec) -> Job:
    """What collecting `spec` would do here and now.

    Raises: SpecError or UsageError for tasks or a behaviour that are not there; DataError for a
        local file of rates or references that is none; StorageError.
    """
    ladder = load_ladder(spec)
    return Job(make_plan(spec, find_records(spec, ladder)), ladder)
