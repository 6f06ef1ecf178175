"""Every random number in a dataset comes from here: one root seed, split by named keys.

    SeedSequence(seed, spawn_key=(family, task, quality, block, row, stream))

Keys are positions, never totals, so adding tasks, episodes or qualities changes no
existing episode. The numbers below are part of the identity of the data: append, never
reuse or renumber.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

UNKNOWN_SEED_KEY = (4294967295,) * 5

HISTORY_STRIDE = 65536
"""In `history` the block number of a seed key is rung * HISTORY_STRIDE + block (rule D1)."""


class Stream(IntEnum):
    """What a random number is for, within one episode."""

    RESET = 0
    POLICY = 1
    GOAL = 2
    UNIFORM = 3


class Quality(IntEnum):
    """Third element of the seed key. The first four are also stored per episode."""

    RANDOM = 0
    MEDIUM = 1
    EXPERT = 2
    HISTORY = 3
    TTA = 4
    REFERENCE_ZERO = 5
    REFERENCE_RANDOM = 6
    REFERENCE_EXPERT = 7
    EVALUATION = 8
    CALIBRATION = 9
    PRETRAINING = 10
    GOALS = 11
    REFERENCE_CONSTANT = 12


@dataclass(frozen=True)
class SeedKey:
    """Names the randomness of one episode (`row` of `block`)."""

    seed: int
    family: int
    task: int
    quality: int
    block: int
    row: int

    @property
    def spawn_key(self) -> tuple[int, int, int, int, int]:
        """What `/episodes/seed_key` stores: the key without seed and stream."""
        return (self.family, self.task, self.quality, self.block, self.row)

    def sequence(self, stream: Stream) -> np.random.SeedSequence:
        import numpy as np  # `mpdt-data list` names seeds and draws nothing

        return np.random.SeedSequence(self.seed, spawn_key=(*self.spawn_key, int(stream)))

    def generator(self, stream: Stream) -> np.random.Generator:
        import numpy as np

        return np.random.Generator(np.random.PCG64(self.sequence(stream)))

    def env_seed(self, stream: Stream = Stream.RESET) -> int:
        """Seed for `env.reset(seed=...)`: first 64-bit word of the stream, shifted to fit int64."""
        import numpy as np

        word = self.sequence(stream).generate_state(1, np.uint64)[0]
        return int(word) >> 1

    def at_row(self, row: int) -> SeedKey:
        return replace(self, row=row)


PHASES = ("teacher", "student", "statistics", "adapt", "mixing")
"""Phases of a training run, in the order of their spawn keys: append only."""


def phase_seed(seed: int, phase: str) -> int:
    """Independent batches for each phase: SeedSequence(seed, spawn_key=(number of phase,))."""
    import numpy as np

    words = np.random.SeedSequence(seed, spawn_key=(PHASES.index(phase),))
    return int(words.generate_state(1, np.uint32)[0])
