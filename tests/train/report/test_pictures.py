"""Pictures of a study as files: what they show, and of which cell."""

from dataclasses import replace
from xml.etree import ElementTree

import msgspec
import numpy as np
import pytest
import torch

from mpdt.model.weights import WeightsHeader, save_weights
from mpdt.train.evaluate.score import MEAN, Score
from mpdt.train.report import pictures
from mpdt.train.report.pictures import draw_kept_prompts, draw_prompts, draw_study
from mpdt.train.study.cells import CellResult
from mpdt.train.study.maps import KEPT, MAPS, keep_prompts, prompt_maps

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


def drawn(path):
    """Classes of what a picture holds, and its texts; it has to be well-formed XML."""
    parts = list(ElementTree.parse(path).iter())
    return [part.get("class", "") for part in parts], [part.text for part in parts if part.text]


def test_a_study_and_the_prompts_are_drawn(tmp_path, weights):
    made = draw_study(CELLS, tmp_path / "out")
    names = ["d-tasks.svg", "d-each-task.svg", "d-training.svg", "d-adaptation.svg"]
    assert [path.name for path in made] == names
    classes, texts = drawn(made[0])
    assert "k-c2" in classes and {"m infer", "X+rewards"} <= set(texts), "coloured by what it read"
    (maps,) = draw_prompts(weights, tmp_path / "out")
    assert maps.name == "prompts.svg" and maps.read_text().count("<image ") == 3
    assert {"P_c", "P_0", "P_1"} <= set(drawn(maps)[1])


def test_own_episodes_are_a_line_per_row(tmp_path):
    """One count alone makes no line, and no picture."""
    rows = [("random", 0.0, None), *((f"m {count} own episodes", count / 10, "trials")
            for count in (1, 3, 10))]  # fmt: skip
    scores = tuple(
        Score(block="test", task=task, method=method, mean=mean, low=mean, high=mean,
              normalised=mean, success=mean, reads=reads)
        for method, mean, reads in rows for task in ("a", MEAN)
    )  # fmt: skip
    made = draw_study([CellResult("d", "m", 0, scores, {})], tmp_path)
    (path,) = [path for path in made if path.name == "d-trials.svg"]
    classes, texts = drawn(path)
    assert {"mean return", "success", "m own episodes", "own episodes on each task"} <= set(texts)
    assert sum("k-c0" in one for one in classes) >= 2
    few = CellResult("d", "m", 0, scores[:4], {})
    assert "d-trials.svg" not in [path.name for path in draw_study([few], tmp_path / "few")]


def test_what_has_nothing_to_show_is_left_out(tmp_path):
    silent = [replace(CELLS[0], content={"cell": "d.m.s0"})]
    made = draw_study(silent, tmp_path)
    assert [path.name for path in made] == ["d-tasks.svg", "d-each-task.svg"]


def test_names_are_whole_and_a_foreign_one_stays_text(tmp_path):
    """Nothing can be pointed at in a linked picture, so nothing is shortened in it."""
    name = "a method <b>with a long</b> & strange name"
    scores = tuple(msgspec.structs.replace(score, method=name) for score in SCORES)
    (path, *_) = draw_study([replace(CELLS[0], scores=scores)], tmp_path)
    assert name in drawn(path)[1]


def test_seeds_are_thin_and_their_mean_is_thick():
    """Seeds lose 1 and 3 at the first step: 2 on average."""
    cells = [CellResult("d", "m", seed, (), {"curve": {"student": [[1, loss], [2, 1.0]]}})
             for seed, loss in ((0, 1.0), (1, 3.0))]  # fmt: skip
    (chart,) = pictures._training("d", cells).charts
    assert chart.title == "m" and [mark.key for mark in chart.marks] == ["thin", "thin", "c0"]
    assert chart.marks[-1].points.tolist() == [[1.0, 2.0], [2.0, 1.0]]


def test_of_a_study_the_prompts_that_it_kept_are_drawn(tmp_path, weights):
    assert keep_prompts(weights, tmp_path / f"d.m.s0{KEPT}")
    (maps,) = draw_kept_prompts(CELLS, tmp_path, tmp_path / "out")
    assert maps.name == "d-prompts.svg"
    assert draw_kept_prompts(CELLS, tmp_path / "elsewhere", tmp_path / "out") == []


def test_of_several_cells_mpdt_e_is_drawn(tmp_path, weights, monkeypatch):
    both = [replace(CELLS[0], label=label, content={"cell": f"d.{label}.s0"})
            for label in ("m", "MPDT-E")]  # fmt: skip
    for cell in both:
        keep_prompts(weights, tmp_path / f"{cell.content['cell']}{KEPT}")
    chosen = []
    monkeypatch.setattr(pictures, "draw_prompts", lambda path, *_: chosen.append(path.name) or [])
    draw_kept_prompts(both, tmp_path, tmp_path)
    assert chosen == [f"d.MPDT-E.s0{KEPT}"]


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
    assert draw_prompts(path, tmp_path) == []
    assert not keep_prompts(path, tmp_path / "kept") and not (tmp_path / "kept").exists()


def test_of_many_tasks_each_is_a_row_of_dots(tmp_path):
    """Thirteen: task k returns k, so the last one is first; the mean is no task."""
    scores = tuple(
        Score(block="test", task=task, method=method, mean=mean, low=mean - 1, high=mean + 1,
              normalised=mean, success=None, reads=reads)
        for method, reads in (("random", None), ("m infer", "X+rewards"))
        for task, mean in [(f"t{k:02}", float(k)) for k in range(13)] + [(MEAN, 6.0)]
    )  # fmt: skip
    made = draw_study([CellResult("d", "m", 0, scores, {})], tmp_path)
    (path,) = [path for path in made if path.name == "d-each-task.svg"]
    classes, texts = drawn(path)
    tasks = [text for text in dict.fromkeys(texts) if text[0] == "t" and text[1:].isdigit()]
    assert tasks == [f"t{k:02}" for k in range(12, -1, -1)]
    assert classes.count("k-c2") == 13 + 1 and "<polyline" not in path.read_text(), "no intervals"
