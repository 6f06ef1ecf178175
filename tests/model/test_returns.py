from __future__ import annotations

import numpy as np
import pytest
import torch

from mpdt.errors import DataError
from mpdt.model.returns import ReturnTable, family_returns, per_task_returns


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


def test_per_task_scale_is_the_largest_magnitude_seen() -> None:
    """Negative task: scale 80, best episode starts at -20 but returns-to-go end at -1."""
    table = per_task_returns([np.array([-80.0, -20.0, -1.0]), np.array([[5.0, 40.0]])])
    assert table.scale.tolist() == [80.0, 40.0]
    assert table.low.tolist() == [-80.0, 5.0]
    assert table.high.tolist() == [-1.0, 40.0]
    assert per_task_returns([np.zeros(3)]).scale.tolist() == [1.0]


def test_target_is_the_best_episode_not_the_last_step() -> None:
    starts = [np.array([-80.0, -20.0]), np.array([40.0])]
    table = per_task_returns([np.array([-80.0, -20.0, -1.0]), np.array([5.0, 40.0])], starts)
    assert table.target.tolist() == [-20.0, 40.0]


def test_family_scale_keeps_the_ranges_of_each_task() -> None:
    table = family_returns([np.array([-80.0, 0.0]), np.array([-9.0, 0.0])], 0.0, 500.0)
    assert table.scale.tolist() == [500.0, 500.0]
    assert table.low.tolist() == [-80.0, -9.0]
    assert table.target.tolist() == [0.0, 0.0]


def test_unseen_tasks_take_mean_scale_widest_range_own_target() -> None:
    table = per_task_returns([np.array([-80.0, -1.0]), np.array([5.0, 40.0])]).pooled([7.0])
    assert (table.scale.item(), table.low.item(), table.high.item()) == (60.0, -80.0, 40.0)
    assert (table.target.item(), len(table)) == (7.0, 1)


def test_impossible_tables() -> None:
    one = torch.ones(1)
    with pytest.raises(DataError, match="must be positive"):
        ReturnTable(0 * one, one, one, one)
    with pytest.raises(DataError, match="upside down"):
        ReturnTable(one, one, 0 * one, one)
