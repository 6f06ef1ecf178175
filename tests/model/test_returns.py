from __future__ import annotations

import pytest
import torch

from mpdt.errors import DataError
from mpdt.model.returns import ReturnTable


def test_clip_then_divide_worked_by_hand() -> None:
    """Row 0 as in the docstring; row 1 has scale 10 and range 0 to 30."""
    table = ReturnTable(
        torch.tensor([100.0, 10.0]), torch.tensor([-100.0, 0.0]),
        torch.tensor([0.0, 30.0]), torch.tensor([0.0, 30.0]),
    )  # fmt: skip
    raw = torch.tensor([[-150.0, -40.0, 20.0], [-5.0, 5.0, 50.0]])
    clipped = table.normalise(raw, clip=True).tolist()
    assert clipped[0] == pytest.approx([-1.0, -0.4, 0.0])
    assert clipped[1] == pytest.approx([0.0, 0.5, 3.0])
    assert table.normalise(raw, clip=False)[0].tolist() == pytest.approx([-1.5, -0.4, 0.2])
    turned = table.select(torch.tensor([1, 0]))
    assert turned.normalise(raw[:, None, :], True)[0, 0].tolist() == pytest.approx([0, 0, 2.0])


def test_unseen_tasks_take_mean_scale_widest_range_own_target() -> None:
    table = ReturnTable(
        torch.tensor([80.0, 40.0]), torch.tensor([-80.0, 5.0]),
        torch.tensor([-1.0, 40.0]), torch.tensor([-1.0, 40.0]),
    ).pooled([7.0])  # fmt: skip
    assert (table.scale.item(), table.low.item(), table.high.item()) == (60.0, -80.0, 40.0)
    assert (table.target.item(), len(table)) == (7.0, 1)


def test_impossible_tables() -> None:
    one = torch.ones(1)
    with pytest.raises(DataError, match="must be positive"):
        ReturnTable(0 * one, one, one, one)
    with pytest.raises(DataError, match="upside down"):
        ReturnTable(one, one, 0 * one, one)
