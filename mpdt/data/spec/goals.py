"""GoalSet: the numbered goals of each task, where a family trains on some and tests on others.

    number      0  1  2 ..              ..  count-1
                '---- training ----' '-- held out --'
    episode     the training goals in turn        TTA set     the held-out ones in turn

Without a set every episode has a goal of its own. MT10 and MT50 have no test tasks, so what is
unseen there is the goal, as in Prompt-DT's split of 45 and 5.
"""

from __future__ import annotations

import msgspec

from mpdt.seeding import HISTORY_STRIDE, Quality, SeedKey

MOST_GOALS = 1_000_000


class GoalSet(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How many goals a task has, and how many of them, the last ones, no training episode uses."""

    count: int
    held_out: int

    @property
    def problem(self) -> str:
        """What is wrong with these numbers, or nothing."""
        if 0 < self.held_out < self.count <= MOST_GOALS:
            return ""
        if self.count > MOST_GOALS:
            return f"{self.count:,} goals are too many: at most {MOST_GOALS:,}"
        return f"{self.held_out} of {self.count} goals cannot be held out"

    def training_key(self, key: SeedKey, block_rows: int) -> SeedKey:
        """What the goal of a training episode is drawn from, given the episode's own key.

        Episodes take the goals in turn; each rung of `history` starts one goal later.
        """
        rung, number = divmod(key.block, HISTORY_STRIDE)
        place = rung + number * block_rows + key.row
        return _goal_key(key, place % (self.count - self.held_out))

    def held_out_key(self, key: SeedKey, block_rows: int) -> SeedKey:
        """What the goal of an episode on unseen goals is drawn from: held-out goals in turn."""
        place = key.block * block_rows + key.row
        return _goal_key(key, self.count - self.held_out + place % self.held_out)


def _goal_key(key: SeedKey, number: int) -> SeedKey:
    return SeedKey(key.seed, key.family, key.task, int(Quality.GOALS), 0, number)
