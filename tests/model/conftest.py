"""Tiny random models of both shapes, and windows with pads, for all tests of the model layer."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch

from mpdt.model.backbone import Backbone, load_backbone
from mpdt.model.policy import PolicyBatch

SHAPES = ("random:tiny", "random:tiny-llama")


@pytest.fixture(autouse=True, scope="session")
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session", params=SHAPES)
def backbone(request: pytest.FixtureRequest) -> Backbone:
    """gpt2 shaped (learned positions) and llama shaped (rotary), float32."""
    return load_backbone(request.param, dtype="float32", seed=3)


@pytest.fixture(scope="session")
def gpt2_shaped() -> Backbone:
    return load_backbone("random:tiny", dtype="float32", seed=3)


def numbers(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def left_padded(n: int, M: int, K: int, pads: int) -> torch.Tensor:
    """Mask (n, M, K): the first window of every task has `pads` pads, the others none."""
    mask = torch.ones(n, M, K, dtype=torch.bool)
    mask[:, 0, :pads] = False
    return mask


def windows(n: int, M: int, K: int, D: int, A: int, pads: int = 0, seed: int = 0) -> PolicyBatch:
    """Windows that start at step 0 (behind pads) or at step 7."""
    mask = left_padded(n, M, K, pads)
    steps = torch.arange(K).expand(n, M, K) + 7
    steps = torch.where(torch.arange(M)[None, :, None] == 0, steps - 7 - pads, steps)
    return PolicyBatch(
        observations=numbers(n, M, K, D, seed=seed),
        previous_actions=numbers(n, M, K, A, seed=seed + 1),
        returns_to_go=numbers(n, M, K, seed=seed + 2),
        timesteps=steps.clamp(min=0),
        mask=mask,
        actions=numbers(n, M, K, A, seed=seed + 3),
    )
