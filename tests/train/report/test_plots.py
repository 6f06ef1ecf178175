"""Pictures are drawn where matplotlib is installed, and missed politely where it is not."""

import importlib.util
import logging
from dataclasses import replace

import numpy as np
import pytest
import torch

from mpdt.model.weights import WeightsHeader, save_weights
from mpdt.train.evaluate.score import MEAN, Score
from mpdt.train.report import plots
from mpdt.train.report.plots import plot_kept_prompts, plot_prompts, plot_study
from mpdt.train.study.maps import KEPT, MAPS, keep_prompts, prompt_maps
from mpdt.train.study.summary import CellResult

SCORES = tuple(
    Score(block="test", task=task, method="m infer", mean=1.0, low=0.5, high=1.5, normalised=0.1,
          reads="X+rewards")
    for task in ("a", MEAN)
)  # fmt: skip
CURVES = {"student": [[1, 0.5], [2, 0.1]], "adapt cross": [[0, 2.0], [1, 1.5]]}
CELLS = [CellResult("d", "m", 0, SCORES, {"curve": CURVES, "cell": "d.m.s0"})]


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
    made = plot_study(CELLS, tmp_path / "out")
    names = ["d-tasks.png", "d-each-task.png", "d-training.png", "d-adaptation.png"]
    assert [path.name for path in made] == names and all(p.stat().st_size > 5000 for p in made)
    (maps,) = plot_prompts(weights, tmp_path / "out")
    assert maps.name == "prompts.png"


def test_curves_of_seeds_are_one_line():
    """Seeds lose 1 and 3 at the first step: 2 on average."""
    from matplotlib.figure import Figure

    figure = Figure()
    cells = [CellResult("d", "m", seed, (), {"curve": {"student": [[1, loss], [2, 1.0]]}})
             for seed, loss in ((0, 1.0), (1, 3.0))]  # fmt: skip
    plots._PICTURES["training"](figure, cells)
    (line,) = figure.axes[0].lines
    assert line.get_label() == "m" and list(line.get_ydata()) == [2.0, 1.0]


def test_of_a_study_the_prompts_that_it_kept_are_drawn(tmp_path, weights):
    assert keep_prompts(weights, tmp_path / f"d.m.s0{KEPT}")
    (maps,) = plot_kept_prompts(CELLS, tmp_path, tmp_path / "out")
    assert maps.name == "d-prompts.png"
    assert plot_kept_prompts(CELLS, tmp_path / "elsewhere", tmp_path / "out") == []


def test_of_several_cells_mpdt_e_is_drawn(tmp_path, weights, monkeypatch):
    both = [replace(CELLS[0], label=label, content={"cell": f"d.{label}.s0"})
            for label in ("m", "MPDT-E")]  # fmt: skip
    for cell in both:
        keep_prompts(weights, tmp_path / f"{cell.content['cell']}{KEPT}")
    drawn = []
    monkeypatch.setattr(plots, "plot_prompts", lambda path, *_: drawn.append(path.name) or [])
    plot_kept_prompts(both, tmp_path, tmp_path)
    assert drawn == [f"d.MPDT-E.s0{KEPT}"]


def test_what_is_kept_is_drawn_as_the_whole_would_be(tmp_path):
    v, u = torch.rand(MAPS + 2, 3, 2), torch.rand(MAPS + 2, 2, 4)
    tensors = {"prompts.cross": torch.rand(3, 4), "prompts.task_v": v, "prompts.task_u": u,
               "policy.head": torch.ones(9)}  # fmt: skip
    save_weights(tmp_path / "w.safetensors", tensors, WeightsHeader(kind="mpdt"))
    keep_prompts(tmp_path / "w.safetensors", tmp_path / "kept.safetensors")
    whole, kept = (
        prompt_maps(tmp_path / "w.safetensors"),
        prompt_maps(tmp_path / "kept.safetensors"),
    )
    assert list(kept) == list(whole) == ["P_c", *(f"P_{k}" for k in range(MAPS))]
    torch.testing.assert_close(torch.from_numpy(whole["P_9"]), v[9] @ u[9])
    for name, values in whole.items():
        assert np.abs(kept[name] - values).max() < 3e-3, name


def test_prompts_of_other_kinds_have_no_maps(tmp_path):
    path = tmp_path / "w.safetensors"
    save_weights(path, {"prompts.cross": torch.ones(3, 4)}, WeightsHeader(kind="mpdt"))
    assert plot_prompts(path, tmp_path) == []
    assert not keep_prompts(path, tmp_path / "kept") and not (tmp_path / "kept").exists()
