"""Moments by hand; batches merged one by one equal all at once."""

from types import SimpleNamespace

import pytest
import torch

from mpdt.errors import UsageError
from mpdt.train.adapt import statistics
from mpdt.train.adapt.statistics import StatisticsSettings, moments, source_statistics


def test_moments_by_hand():
    """One task, one window of 3 steps, the first a pad: values 2 and 4, mean 3, variance 1."""
    features = (torch.tensor([[[[99.0], [2.0], [4.0]]]]),)
    mask = torch.tensor([[[False, True, True]]])
    mean, variance = moments(features, mask, "channel")
    assert mean.tolist() == [[[3.0]]] and variance.tolist() == [[[1.0]]]


def test_moments_by_position():
    """Two windows; position 0 is real in the second only."""
    features = (torch.tensor([[[[9.0], [1.0]], [[5.0], [3.0]]]]),)
    mask = torch.tensor([[[False, True], [True, True]]])
    mean, variance = moments(features, mask, "position")
    assert mean.tolist() == [[[[5.0], [2.0]]]] and variance.tolist() == [[[[0.0], [1.0]]]]


def test_tasks_stay_apart():
    features = (torch.tensor([[[[1.0]]], [[[3.0]]]]),)
    mean, _ = moments(features, torch.ones(2, 1, 1, dtype=torch.bool), "channel")
    assert mean.tolist() == [[[1.0]], [[3.0]]]


@pytest.mark.parametrize("axes", ["channel", "position"])
def test_merged_batches_equal_all_at_once(monkeypatch, axes):
    """The slow twin looks at every real step of all batches together."""
    generator = torch.Generator().manual_seed(0)
    batches = [
        (tuple(torch.randn(2, 2, 3, 4, 5, generator=generator) + 7),
         torch.rand(2, 3, 4, generator=generator) > 0.3)
        for _ in range(3)
    ]  # fmt: skip
    batches[0][1][:, :, 0] = False  # nobody shows that position in this batch
    monkeypatch.setattr(statistics, "_features", lambda *_: iter(batches))
    found = source_statistics(None, None, None, None, StatisticsSettings(axes=axes))
    for layer in range(2):
        rows = torch.cat([features[layer] for features, _ in batches])
        mask = torch.cat([mask for _, mask in batches])
        for position in range(4):
            chosen = rows[mask] if axes == "channel" else rows[:, :, position][mask[:, :, position]]
            at = (layer,) if axes == "channel" else (layer, position)
            torch.testing.assert_close(found.mean[at], chosen.mean(dim=0))
            torch.testing.assert_close(found.variance[at], chosen.var(dim=0, correction=0))


def test_settings_out_of_range():
    with pytest.raises(UsageError, match=r"statistics\.batches"):
        StatisticsSettings(batches=0)


def test_each_training_task_stands_behind_its_own_prompt(monkeypatch):
    """The fake policy answers with the prompt's first number: both tasks' must be seen."""
    prompts = SimpleNamespace(task_prompts=lambda slots: slots[:, None, None].float())
    returns = SimpleNamespace(select=lambda slots: slots)
    windows = SimpleNamespace(slots=torch.tensor([0, 1]).numpy())
    sampler = SimpleNamespace(batch=lambda step: windows)
    batch = SimpleNamespace(mask=torch.ones(2, 1, 1, dtype=torch.bool))
    monkeypatch.setattr(statistics.PolicyBatch, "from_windows", lambda _: batch)

    def policy(_batch, given, _returns, layer_features):
        return SimpleNamespace(features=(given[:, None],))

    found = source_statistics(policy, prompts, sampler, returns, StatisticsSettings(batches=1))
    assert found.mean.item() == 0.5 and found.variance.item() == 0.25
