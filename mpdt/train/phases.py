"""Phases of a run, each with random numbers of its own."""

from __future__ import annotations

import numpy as np

PHASES = ("teacher", "student", "statistics", "adapt", "mixing")


def phase_seed(seed: int, phase: str) -> int:
    """Independent batches for each phase: SeedSequence(seed, spawn_key=(number of phase,))."""
    words = np.random.SeedSequence(seed, spawn_key=(PHASES.index(phase),))
    return int(words.generate_state(1, np.uint32)[0])
