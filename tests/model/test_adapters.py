"""Adapters: every row its own, by hand, and none left behind."""

from __future__ import annotations

import torch
from torch import nn

from mpdt.model.adapters import adapted
from mpdt.model.backbone import load_backbone


def test_by_hand_and_gone_afterwards() -> None:
    """One block, r = s = 1: row 0 h = 1 -> 1 + 3 gelu(2) = 6.86, row 1 has no adapter."""
    blocks = nn.ModuleList([nn.Identity()])
    weights = torch.tensor([[2.0, 3.0], [0.0, 0.0]]).reshape(2, 1, 2, 1, 1)
    h = torch.ones(2, 1, 1)
    with adapted(blocks, weights):
        torch.testing.assert_close(blocks[0](h).flatten(), torch.tensor([6.8635, 1.0]), atol=1e-4,
                                   rtol=0)  # fmt: skip
    assert torch.equal(blocks[0](h), h)
    with adapted(blocks, None):
        assert torch.equal(blocks[0](h), h)


def test_a_backbone_gives_each_task_its_own_adapters() -> None:
    """Task 1's weights are zero: as without any; in the closed loop's cache as in training."""
    backbone = load_backbone("random:tiny", dtype="float32")
    tokens, mask = torch.randn(2, 3, 4, 64), torch.ones(2, 3, 4, dtype=torch.bool)
    plain, _ = backbone(None, tokens, mask)
    backbone.reads_adapters = True
    prompts = torch.randn(2, 2 * 2 * 5, 64)  # L q r
    prompts[1] = 0
    hidden, features = backbone(prompts, tokens, mask, layer_features=True)
    torch.testing.assert_close(hidden[1], plain[1])
    assert not torch.allclose(hidden[0], plain[0]) and len(features) == 2
    prefix = backbone.encode_prefix(prompts).select(torch.tensor([0, 0, 0]))
    again, _ = backbone.forward_with_cache(prefix, tokens[0], mask[0])
    torch.testing.assert_close(again, hidden[0])
