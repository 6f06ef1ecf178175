"""Held-out mixtures: which tasks get one, found again by speed."""

import numpy as np
import pytest
import torch

from mpdt.errors import UsageError
from mpdt.train.infer import InferSettings, Transitions
from mpdt.train.mixing import MixingSettings, held_out_weights

SETTINGS = MixingSettings(
    share=0.5, model=InferSettings(hidden=32, steps=600, batch=128, lr=1e-2), unexplained=0.05
)


def speeds(goal, seed, num=600):
    """One observation, the speed below every goal; reward speed - goal, known without error."""
    generator = np.random.Generator(np.random.PCG64(seed))
    inputs = generator.uniform(0, 1, (num, 3)).astype(np.float32)
    return Transitions(inputs, inputs[:, 0] - np.float32(goal))


@pytest.fixture(scope="module")
def weights():
    torch.set_num_threads(1)
    return held_out_weights([speeds(goal, i) for i, goal in enumerate((1, 2, 3))], SETTINGS, 0)


def test_only_the_task_between_two_is_mixed(weights):
    """2 = half of 1 and half of 3; 1 and 3 lie at the ends and keep their own prompts."""
    assert weights[0].tolist() == [1, 0, 0] and weights[2].tolist() == [0, 0, 1]
    assert weights[1, 1] == 0
    assert weights[1].tolist() == pytest.approx([0.5, 0, 0.5], abs=0.1)


def test_a_task_the_others_do_not_explain_keeps_its_prompt():
    """Between the two others on average, but its rewards follow another observation."""
    odd = speeds(2, 7)
    odd = Transitions(odd.inputs, odd.inputs[:, 1] * 4 - 4)
    found = held_out_weights([speeds(1, 0), odd, speeds(3, 2)], SETTINGS, 0)
    assert torch.equal(found, torch.eye(3))


def test_settings_out_of_range_are_refused():
    with pytest.raises(UsageError, match=r"mixing\.share.*expected 0 to 1, found 1\.5"):
        MixingSettings(share=1.5)
