"""Seed keys: positions decide, streams differ, numbers are pinned."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from gymnasium.utils import seeding

from mpdt.seeding import (
    PHASES,
    Beside,
    Quality,
    SeedKey,
    Stream,
    generator_at,
    generator_of,
    layers_from,
    phase_seed,
    torch_generator,
    torch_generator_at,
)

KEY = SeedKey(seed=20240901, family=0, task=1, quality=Quality.EXPERT, block=3, row=4)


def test_spawn_key_is_position_without_seed_and_stream() -> None:
    assert KEY.spawn_key == (0, 1, 2, 3, 4)
    assert KEY.at_row(9).spawn_key == (0, 1, 2, 3, 9)


def test_generator_is_numpys_own_for_that_key() -> None:
    sequence = np.random.SeedSequence(20240901, spawn_key=(0, 1, 2, 3, 4, 2))
    want = np.random.Generator(np.random.PCG64(sequence)).random(4)
    assert np.array_equal(KEY.generator(Stream.GOAL).random(4), want)


def test_env_seed_is_half_the_first_word_and_fits_int64() -> None:
    sequence = np.random.SeedSequence(20240901, spawn_key=(0, 1, 2, 3, 4, 0))
    word = int(sequence.generate_state(1, np.uint64)[0])
    assert KEY.env_seed() == word // 2
    assert KEY.env_seed() < 2**63


def test_every_part_of_the_key_matters() -> None:
    others = [
        SeedKey(1, 0, 1, 2, 3, 4),
        SeedKey(20240901, 1, 1, 2, 3, 4),
        SeedKey(20240901, 0, 0, 2, 3, 4),
        SeedKey(20240901, 0, 1, 1, 3, 4),
        SeedKey(20240901, 0, 1, 2, 2, 4),
        SeedKey(20240901, 0, 1, 2, 3, 5),
    ]
    seeds = {KEY.env_seed(), *(key.env_seed() for key in others)}
    seeds |= {KEY.env_seed(stream) for stream in Stream}
    assert len(seeds) == 7 + 4


def test_stored_codes_never_change() -> None:
    """They are written into files and seed keys: appending is the only change allowed."""
    codes = {quality.name: int(quality) for quality in Quality}
    assert codes == {
        "RANDOM": 0,
        "MEDIUM": 1,
        "EXPERT": 2,
        "HISTORY": 3,
        "TTA": 4,
        "REFERENCE_ZERO": 5,
        "REFERENCE_RANDOM": 6,
        "REFERENCE_EXPERT": 7,
        "EVALUATION": 8,
        "CALIBRATION": 9,
        "PRETRAINING": 10,
        "GOALS": 11,
        "REFERENCE_CONSTANT": 12,
        "POLICY": 13,
        "TRIAL": 14,
        "RECORDED": 15,
    }
    assert [int(stream) for stream in Stream] == [0, 1, 2, 3, 4]


def test_streams_of_training_keep_their_numbers() -> None:
    """Drawn with numpy and torch alone, before these functions were written."""
    assert KEY.generator(Stream.GOAL).integers(1000, size=4).tolist() == [736, 171, 17, 2]
    assert generator_of(5).integers(1000, size=4).tolist() == [670, 805, 22, 807]
    assert generator_at(5, 7).integers(1000, size=4).tolist() == [301, 512, 846, 292]
    shown = generator_at(5, 7, Beside.DEMONSTRATION)
    assert shown.integers(1000, size=4).tolist() == [944, 967, 303, 428]
    assert torch_generator_at(5, 7, Beside.DROPOUT).initial_seed() == 8669751424075416578
    drawn = torch.randint(1000, (4,), generator=torch_generator(5))
    assert drawn.tolist() == [411, 814, 767, 885]
    assert [phase_seed(5, phase) for phase in PHASES] == [
        803261128, 3767054407, 3210010690, 2928346150, 3860361780, 4170728348,
        456984185,
    ]  # fmt: skip


def test_an_environment_is_seeded_as_gymnasium_does() -> None:
    ours, theirs = generator_of(11), seeding.np_random(11)[0]
    assert ours.bit_generator.state == theirs.bit_generator.state
    assert generator_of(None).random() != generator_of(None).random()


def test_layers_start_from_their_seed_and_leave_the_global_generator_alone() -> None:
    before = torch.random.get_rng_state()
    with layers_from(5):
        first = torch.nn.Linear(2, 2).weight
    with layers_from(5):
        again = torch.nn.Linear(2, 2).weight
    assert torch.equal(first, again) and torch.equal(before, torch.random.get_rng_state())
    assert first[0, 0].item() == pytest.approx(0.4670467, rel=1e-5)
