"""What a notebook shows of a data set: the numbers of its tables, and text that stays text."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mpdt.data.store import shown
from mpdt.data.store.reader import open_dataset
from mpdt.data.store.shown import Slices, dataset_html


def cells(html: str) -> list[list[str]]:
    rows = html.split("<tr>")[1:]
    return [[part.split("<")[0] for part in row.split('">')[1:]] for row in rows]


def test_a_data_set_shows_the_returns_of_its_tasks(
    collected: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = open_dataset(collected)
    heading, *rows = cells(data._repr_html_())
    assert heading[:3] == ["task", "role", "episodes"]
    assert [row[0] for row in rows] == list(data.tasks.names)
    for row, found in enumerate(rows):
        own = data.episodes.task == row
        assert found[2] == str(int(own.sum()))
        for name, mean in zip(heading[3:], found[3:], strict=True):
            ids = data.select(task=row, quality=name)
            wanted = f"{data.episodes.returns[ids].mean():,.1f}" if len(ids) else "-"
            assert mean == wanted
    assert data.slices._repr_html_().count("<tr>") == 1 + len(data.slices)
    monkeypatch.setattr(shown, "MOST_TASKS", 1)
    assert "and 1 tasks more" in data._repr_html_()
    assert "&lt;b&gt;" in dataset_html(replace(data, name="<b>"))


def test_counts_and_roles_are_those_of_the_file(collected: Path) -> None:
    """32 episodes of 5 steps; the second task as if it were only tested on."""
    data = open_dataset(collected)
    assert "32 episodes, 160 steps" in dataset_html(data)
    for roles, names in (((0, 1), ["train", "test"]), ((2, 2), ["both", "both"])):
        data.tasks.roles[:] = roles
        assert [row[1] for row in cells(dataset_html(data))[1:]] == names


def test_slices_say_their_rules() -> None:
    slices = Slices({"mine": np.arange(1200)}, {"mine": {"quality": "medium"}})
    assert cells(slices._repr_html_())[1] == ["mine", "quality=medium", "1,200"]
    again = pickle.loads(pickle.dumps(slices))
    assert again._repr_html_() == slices._repr_html_() and dict(again).keys() == {"mine"}
