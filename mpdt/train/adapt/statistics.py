"""Layer statistics: mean and variance of every block's output, the target of adaptation.

    source       training tasks, each behind its own P*_k     never a test task
    moments      per channel over windows and steps (default), or per window position too
    variance     population variance (divided by the count), as the test side computes it

Source: Samadh et al. 2023 (PromptAlign), equation 5; statistics once, offline.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import msgspec
import torch
from torch import Tensor

from mpdt.data.slices.sampler import WindowSampler
from mpdt.errors import check_at_least
from mpdt.model.policy import PolicyBatch, PromptPolicy
from mpdt.model.prompts import TrainedPrompts
from mpdt.model.returns import ReturnTable


class StatisticsSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the test tasks' features are compared with."""

    source: Literal["training", "random"] = "training"
    """The episodes trained on, or the training tasks' random episodes (X is random as well)."""
    axes: Literal["channel", "position"] = "channel"
    """Moments over all real steps, or for each position of the window apart."""
    batches: int = 50
    """Batches of windows they are computed from."""

    def __post_init__(self) -> None:
        check_at_least("statistics.batches", self.batches, 1)


@dataclass(frozen=True)
class LayerStatistics:
    """mean, variance: (L, s) for `channel`, (L, K, s) for `position`."""

    mean: Tensor
    variance: Tensor


def moments(
    features: tuple[Tensor, ...], mask: Tensor, axes: Literal["channel", "position"]
) -> tuple[Tensor, Tensor]:
    """Mean and variance per task of features L x (n, M, K, s) at the real steps of `mask`.

    Returns: (n, L, s) twice, or (n, L, K, s) for `position`; 0 where a position has no step.
    """
    over = (1, 2) if axes == "channel" else (1,)
    weight = mask[..., None].to(features[0].dtype)
    count = weight.sum(dim=over).clamp_min(1.0)
    means, variances = [], []
    for layer in features:
        mean = (layer * weight).sum(dim=over) / count
        centre = mean[:, None, None] if axes == "channel" else mean[:, None]
        means.append(mean)
        variances.append(((layer - centre).square() * weight).sum(dim=over) / count)
    return torch.stack(means, dim=1), torch.stack(variances, dim=1)


@torch.no_grad()
def source_statistics(
    policy: PromptPolicy,
    prompts: TrainedPrompts,
    sampler: WindowSampler,
    returns: ReturnTable,
    settings: StatisticsSettings,
) -> LayerStatistics:
    """Pooled over `batches` batches of `sampler`; every real step counts the same.

    Batches are merged by counts and moments (Chan et al. 1983), so memory stays that of one.
    """
    total = mean = square = torch.zeros(())
    for features, mask in _features(policy, prompts, sampler, returns, settings.batches):
        over = (0, 1, 2) if settings.axes == "channel" else (0, 1)
        count = mask.sum(dim=over).to(torch.float64)[..., None]
        weight = mask[..., None].to(torch.float64)
        stacked = torch.stack(features).to(torch.float64)
        axes = tuple(axis + 1 for axis in over)
        own_mean = (stacked * weight).sum(dim=axes) / count.clamp_min(1)
        centre = own_mean[:, None, None, None] if len(over) == 3 else own_mean[:, None, None]
        own_square = ((stacked - centre).square() * weight).sum(dim=axes)
        merged = (total + count).clamp_min(1)
        difference = own_mean - mean
        square = square + own_square + difference.square() * total * count / merged
        mean = mean + difference * count / merged
        total = total + count
    variance = square / total.clamp_min(1)
    return LayerStatistics(mean.to(torch.float32), variance.to(torch.float32))


def _features(
    policy: PromptPolicy,
    prompts: TrainedPrompts,
    sampler: WindowSampler,
    returns: ReturnTable,
    batches: int,
) -> Iterator[tuple[tuple[Tensor, ...], Tensor]]:
    """Features L x (n, M, K, s) and mask (n, M, K) of each batch."""
    for step in range(batches):
        windows = sampler.batch(step)
        batch, slots = PolicyBatch.from_windows(windows), torch.from_numpy(windows.slots)
        output = policy(
            batch, prompts.task_prompts(slots), returns.select(slots), layer_features=True
        )
        yield output.features, batch.mask
