"""Pictures are drawn where matplotlib is installed, and missed politely where it is not."""

import importlib.util
import logging

import pytest
import torch

from mpdt.model.weights import WeightsHeader, save_weights
from mpdt.train.plots import plot_prompts, plot_study
from mpdt.train.results import MEAN, Score
from mpdt.train.summary import CellResult

SCORES = tuple(
    Score(block="test", task=task, method="m infer", mean=1.0, low=0.5, high=1.5, normalised=0.1,
          reads="X+rewards")
    for task in ("a", MEAN)
)  # fmt: skip
CURVES = {"student": [[1, 0.5], [2, 0.1]], "adapt cross": [[0, 2.0], [1, 1.5]]}
CELLS = [CellResult("d", "m", 0, SCORES, {"curve": CURVES})]


@pytest.fixture
def weights(tmp_path):
    tensors = {"prompts.cross": torch.ones(3, 4), "prompts.task_v": torch.ones(2, 3, 1),
               "prompts.task_u": torch.ones(2, 1, 4)}  # fmt: skip
    save_weights(tmp_path / "w.safetensors", tensors, WeightsHeader(kind="mpdt"))
    return tmp_path / "w.safetensors"


def test_without_matplotlib_nothing_is_drawn_and_that_is_said(monkeypatch, tmp_path, caplog):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with caplog.at_level(logging.WARNING):
        assert plot_study(CELLS, tmp_path / "out") == []
    assert "mpdt[docs]" in caplog.text and not (tmp_path / "out").exists()


def test_a_study_and_the_prompts_are_drawn(tmp_path, weights):
    pytest.importorskip("matplotlib")
    made = plot_study(CELLS, tmp_path / "out")
    names = ["d-tasks.png", "d-training.png", "d-adaptation.png"]
    assert [path.name for path in made] == names and all(p.stat().st_size > 5000 for p in made)
    (maps,) = plot_prompts(weights, tmp_path / "out")
    assert maps.name == "prompts.png"


def test_prompts_of_other_kinds_have_no_maps(tmp_path):
    path = tmp_path / "w.safetensors"
    save_weights(path, {"prompts.cross": torch.ones(3, 4)}, WeightsHeader(kind="mpdt"))
    assert plot_prompts(path, tmp_path) == []
