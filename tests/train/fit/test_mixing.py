"""Held-out mixtures: which tasks get one, found again by speed."""

import numpy as np
import pytest
import torch

from mpdt.errors import UsageError
from mpdt.train.fit.mixing import MixingSettings, held_out_mixtures
from mpdt.train.fit.reward import RewardSettings, Transitions

SETTINGS = MixingSettings(
    share=0.5,
    model=RewardSettings(tasks=2, hidden=32, steps=600, batch=128, lr=1e-2),
    unexplained=0.05,
)


def speeds(goal, seed, num=600):
    """One observation, the speed below every goal; reward speed - goal, known without error."""
    generator = np.random.Generator(np.random.PCG64(seed))
    inputs = generator.uniform(0, 1, (num, 3)).astype(np.float32)
    return Transitions(inputs, inputs[:, 0] - np.float32(goal))


@pytest.fixture(scope="module")
def mixtures():
    torch.set_num_threads(1)
    tasks = [speeds(goal, i) for i, goal in enumerate((1, 2, 3, 5))]
    return held_out_mixtures(tasks, SETTINGS, 0)


def test_only_tasks_between_others_are_mixed_and_in_every_way(mixtures):
    """2 = 1/2 of 1 + 1/2 of 3 = 3/4 of 1 + 1/4 of 5. 3 = 1/2 of 1 + 1/2 of 5 = 2/3 2 + 1/3 5."""
    assert mixtures[0].shape == (0, 4) and mixtures[3].shape == (0, 4)
    expected = [[0.5, 0, 0.5, 0], [0.75, 0, 0, 0.25]], [[0.5, 0, 0, 0.5], [0, 2 / 3, 0, 1 / 3]]
    for found, ways in zip(mixtures[1:3], expected, strict=True):
        np.testing.assert_allclose(found.numpy(), ways, atol=0.1)


def test_a_task_the_others_do_not_explain_keeps_its_prompt():
    """Between the two others on average, but its rewards follow another observation."""
    odd = speeds(2, 7)
    odd = Transitions(odd.inputs, odd.inputs[:, 1] - 2)
    # Small rewards have small errors: what counts is their share of the variance.
    tasks = [
        Transitions(one.inputs, 0.3 * one.rewards) for one in (speeds(1, 0), odd, speeds(3, 2))
    ]
    found = held_out_mixtures(tasks, SETTINGS, 0)
    assert [len(ways) for ways in found] == [0, 0, 0]


def test_settings_out_of_range_are_refused():
    with pytest.raises(UsageError, match=r"mixing\.share.*expected 0 to 1, found 1\.5"):
        MixingSettings(share=1.5)
