"""Every random number comes from here: one root seed, split by named keys. Used by all of mpdt.

    episodes    SeedSequence(seed, spawn_key=(family, task, quality, block, row, stream))
    updates     SeedSequence([seed, position])  or with the spawn key (Beside,)
    phases      SeedSequence(seed, spawn_key=(place in PHASES,)) -> the seed of a phase
    weights     torch's own generator of a seed

Keys are positions, never totals, so adding tasks, episodes or qualities changes no
existing episode. The numbers below are part of the identity of data and runs: append, never
reuse or renumber. A test forbids making a generator anywhere else.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    import torch

UNKNOWN_SEED_KEY = (4294967295,) * 5

HISTORY_STRIDE = 65536
"""In `history` the block number of a seed key is rung * HISTORY_STRIDE + block (rule D1)."""

PHASES = ("teacher", "student", "statistics", "adapt", "mixing", "validation", "trials")
"""Of a run, each with random numbers of its own; append only."""


class Stream(IntEnum):
    """What a random number is for, within one episode."""

    RESET = 0
    POLICY = 1
    GOAL = 2
    UNIFORM = 3
    NOISE = 4


class Quality(IntEnum):
    """Third element of the seed key. The first four and POLICY are also stored per episode."""

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
    POLICY = 13
    TRIAL = 14
    RECORDED = 15
    """Of an import: the seed stands in its spec, `import.seeds[block][row]`."""


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


class Beside(IntEnum):
    """What an update draws beside its windows, apart from them: the spawn key."""

    DROPOUT = 1
    DEMONSTRATION = 2


def phase_seed(seed: int, phase: str) -> int:
    """The seed of one of PHASES, independent of the others'."""
    import numpy as np

    words = np.random.SeedSequence(seed, spawn_key=(PHASES.index(phase),))
    return int(words.generate_state(1, np.uint32)[0])


def generator_of(seed: int | None) -> np.random.Generator:
    """Of a seed alone, at least 0; None takes one from the system, as gymnasium does."""
    import numpy as np

    return np.random.Generator(np.random.PCG64(seed))


def generator_at(seed: int, position: int, beside: Beside | None = None) -> np.random.Generator:
    """A function of (seed, position): of one update, one task row or one group of tasks."""
    import numpy as np

    return np.random.Generator(np.random.PCG64(_sequence_at(seed, position, beside)))


def torch_generator(seed: int) -> torch.Generator:
    """Of a seed alone, on the processor."""
    import torch

    return torch.Generator().manual_seed(seed)


def torch_generator_at(seed: int, position: int, beside: Beside) -> torch.Generator:
    """As `generator_at`, for torch: seeded with the stream's first 64-bit word, halved."""
    import numpy as np

    word = _sequence_at(seed, position, beside).generate_state(1, np.uint64)[0]
    return torch_generator(int(word) >> 1)


@contextmanager
def layers_from(seed: int) -> Iterator[None]:
    """Layers built inside start from `seed`; they know only torch's global generator, which is
    put back afterwards."""
    import torch

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield


def _sequence_at(seed: int, position: int, beside: Beside | None) -> np.random.SeedSequence:
    import numpy as np

    key = () if beside is None else (int(beside),)
    return np.random.SeedSequence([seed, position], spawn_key=key)
