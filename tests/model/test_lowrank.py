"""LoRA: nothing at first, the stated sum afterwards, on the projections alone."""

from __future__ import annotations

import pytest
import torch

from mpdt.model.backbone import BackboneSettings, from_settings
from mpdt.model.lowrank import LowRank


def test_by_hand() -> None:
    """alpha / r = 2; up (1, 2), down (3, 4): W + 2 (3 4; 6 8)."""
    part = LowRank(torch.zeros(2, 2), 1, 2.0, torch.Generator())
    assert torch.equal(part(torch.ones(2, 2)), torch.ones(2, 2)), "up starts at zero"
    with torch.no_grad():
        part.up.copy_(torch.tensor([[1.0], [2.0]]))
        part.down.copy_(torch.tensor([[3.0, 4.0]]))
    assert part(torch.ones(2, 2)).tolist() == [[7, 9], [13, 17]]


@pytest.mark.parametrize(("name", "each"), [("random:tiny", 1), ("random:tiny-llama", 3)])
def test_every_projection_of_both_blocks_and_nothing_else(name: str, each: int) -> None:
    plain = from_settings(BackboneSettings(name=name))
    backbone = from_settings(BackboneSettings(name=name, lora_rank=2))
    trained = [name for name, p in backbone.named_parameters() if p.requires_grad]
    assert len(trained) == 2 * each * 2 and not backbone.frozen
    assert backbone.fingerprint == plain.fingerprint
    tokens, mask = torch.randn(1, 1, 3, 64), torch.ones(1, 1, 3, dtype=torch.bool)
    same = [b(None, tokens, mask)[0] for b in (plain, backbone)]
    torch.testing.assert_close(*same)
    for module in backbone.modules():
        if isinstance(module, LowRank):
            torch.nn.init.normal_(module.up)
    assert not torch.allclose(backbone(None, tokens, mask)[0], same[0])
