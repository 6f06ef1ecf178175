"""The result page: what is drawn of a run and of a study, and what its names cannot do."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

from mpdt.model.weights import WeightsHeader, save_weights
from mpdt.train.cli import main
from mpdt.train.evaluate.score import EXPERT, MEAN, RANDOM, ZERO, Score, encode_results
from mpdt.train.report.charts import REFERENCE, adaptation_chart, colours, legend, short_names
from mpdt.train.report.page import run_content, study_content, write_result
from mpdt.train.study.cells import CellResult
from mpdt.train.study.maps import map_pixels

EVIL = "</title><script>alert(1)</script>"
NAN = float("nan")


def score(method, task="a", mean=1.0, block="test", **more):
    return Score(block=block, task=task, method=method, mean=mean, low=mean - 1, high=mean + 1,
                 normalised=0.5, **more)  # fmt: skip


def scores(*methods, block="test"):
    return [score(method, task, block=block) for task in ("a", "b", MEAN) for method in methods]


def results(rows, **more):
    header = {"name": "run", "data": {"name": "d", "version": "1.0.0", "quality": "expert"},
              "config": {"seed": 3}, "complete": True}  # fmt: skip
    return json.loads(encode_results(header | more, rows))


@pytest.fixture
def folder(tmp_path):
    """A run's folder: results, a log whose last line was cut off, prompts of two tasks."""
    rows = [*scores(ZERO, RANDOM, "M", EXPERT, block="train"), *scores(ZERO, RANDOM, "M x", "M y")]
    (tmp_path / "results.json").write_text(json.dumps(results(rows)))
    log = [
        {"phase": "student", "step": 1, "action_loss": 0.5},
        {"phase": "student", "step": 2, "action_loss": 0.1},
        {"phase": "adapt", "start": "cross", "step": 0, "losses": [4.0, 2.0]},
        {"phase": "adapt", "start": "cross", "step": 1, "losses": [3.0, 1.0]},
        {"phase": "infer", "task": "a", "weights": {"t1": 0.25, "t2": 0.75}, "error": 0.1},
    ]
    lines = "\n".join(json.dumps(record) for record in log)
    (tmp_path / "metrics.jsonl").write_text(lines + '\n{"phase": "stu')
    tensors = {"prompts.cross": torch.ones(3, 4), "prompts.task_v": torch.ones(2, 3, 1),
               "prompts.task_u": torch.ones(2, 1, 4)}  # fmt: skip
    save_weights(tmp_path / "weights.safetensors", tensors, WeightsHeader(kind="mpdt"))
    return tmp_path


def test_a_run_with_all_its_parts(folder, tmp_path):
    content = run_content(json.loads((folder / "results.json").read_text()), folder)
    train, test = content.parts
    assert train.title == "Training tasks (each with its own prompt)"
    assert [chart.title for chart in test.tasks] == ["a", "b"]
    assert test.means[0].row_names == (ZERO, RANDOM, "x", "y")
    assert [group.title for group in content.curves] == ["Learning", "Adaptation"]
    assert content.inferred == [("a", "t2 0.75, t1 0.25")]
    assert [name for name, _ in content.maps] == ["P_c", "P_0", "P_1"]
    assert dict(content.facts)["seed"] == "3" and content.warnings == []
    write_result(tmp_path / "page.html", content)
    page = (tmp_path / "page.html").read_text()
    # mean and two tasks of each block, one of learning, one of adaptation
    assert page.count("<svg") == 2 * 3 + 2 and page.count("<img") == 3
    assert "script" not in page.lower()


def test_from_the_command_line(folder, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["report", str(folder), "--html", str(folder / "p.html")])
    assert not stop.value.code
    assert "M x" in capsys.readouterr().out and (folder / "p.html").stat().st_size > 9000


@pytest.mark.parametrize(
    "damage",
    [{"data": 3}, {"config": []}, {"backbone": "gpt2"}, {"updates": {"student": "9"}},
     {"complete": False, "updates_asked": 1}, {"scores": [3]},
     {"num_trainables": "many"}],
)  # fmt: skip
def test_damaged_results_of_a_run_are_one_error(folder, capsys, damage):
    content = results(scores("M")) | damage
    (folder / "results.json").write_text(json.dumps(content))
    with pytest.raises(SystemExit) as stop:
        main(["report", str(folder), "--html", str(folder / "p.html")])
    out, error = capsys.readouterr()
    assert stop.value.code == 1 and out == ""
    assert error.startswith(f"error: {folder / 'results.json'}: not the results of a run")


def test_a_run_without_results_is_no_damaged_study(folder, capsys):
    (folder / "results.json").rename(folder / "config.json")
    with pytest.raises(SystemExit) as stop:
        main(["report", str(folder)])
    assert stop.value.code == 2
    assert "the same command continues it" in capsys.readouterr().err


def test_a_run_of_results_alone_has_a_page_too(tmp_path):
    content = run_content(results(scores("M")), tmp_path)
    assert not content.curves and not content.maps and not content.warnings
    write_result(tmp_path / "page.html", content)


def test_damaged_prompts_and_an_unfinished_run_are_told(tmp_path):
    (tmp_path / "weights.safetensors").write_bytes(b"x")
    unfinished = {"complete": False, "updates": {"student": 5}, "updates_asked": {"student": 9}}
    told = run_content(results(scores("M"), **unfinished), tmp_path).warnings
    assert told[0] == "Incomplete, ended by a time limit after updates: student 5 of 9."
    assert told[1].startswith("No maps of the prompts: ")


def test_what_was_not_measured_has_no_bar_but_stands_in_the_table(tmp_path):
    rows = [score("M"), score("M", MEAN), score(EXPERT, mean=NAN), score(EXPERT, MEAN, mean=NAN)]
    (part,) = run_content(results(rows), tmp_path).parts
    assert part.means[0].row_names == ("M",)
    assert "not measured" in part.tables[0].rows[1]


def test_methods_have_colours_and_references_are_grey():
    keys = colours([ZERO, "M", RANDOM, "N", "M"])
    assert keys == {ZERO: REFERENCE, "M": "c0", RANDOM: REFERENCE, "N": "c1"}
    assert legend(keys) == [("c0", "M"), ("c1", "N"), (REFERENCE, "references")]
    assert legend({"M": "c0"}) == [("c0", "M")]


def test_rows_leave_out_what_all_methods_begin_with():
    names = [RANDOM, "MPDT infer", "MPDT from cross, adapted"]
    assert list(short_names(colours(names)).values()) == [RANDOM, "infer", "from cross, adapted"]
    for same in (["MPDT"], ["MPDT", "MT-BC"], ["MPDT", "MPDT infer"]):
        assert list(short_names(colours(same))) == list(short_names(colours(same)).values())


def test_adaptation_shows_every_task_and_their_mean():
    """Losses 4 and 2, then 3 and 1: means 3 and 2."""
    first, second, middle = adaptation_chart("cross", [(0, [4.0, 2.0]), (1, [3.0, 1.0])]).marks
    assert first.points.tolist() == [[0, 4], [1, 3]] and second.points.tolist() == [[0, 2], [1, 1]]
    assert middle.points.tolist() == [[0, 3], [1, 2]]


def test_colours_of_a_map():
    """White at zero, red and blue at the ends; a map of zeros is white."""
    pixels = map_pixels(np.array([[1.0, 0.0, -1.0]], np.float32))
    assert pixels[0].tolist() == [[178, 24, 43], [247] * 3, [33, 102, 172]]
    assert (map_pixels(np.zeros((2, 2), np.float32)) == 247).all()


def test_a_study_has_a_part_for_each_data_set_and_block(tmp_path):
    curve = {"student": [[1, 0.5], [2, 0.1]], "adapt cross": [[0, 2.0], [1, 1.5]]}
    cells = [
        CellResult("d", label, seed, tuple(scores(ZERO, label)), {"curve": curve})
        for label in ("m", "n") for seed in (0, 1)
    ]  # fmt: skip
    content = study_content(cells, "first")
    (part,) = content.parts
    assert part.title == "d: test tasks" and part.means[0].row_names == (ZERO, "m", "n")
    assert [group.title for group in content.curves] == ["Learning, d", "Adaptation, d"]
    assert [drawn.title for drawn in content.curves[1].charts] == ["m cross", "n cross"]
    assert len(content.curves[1].charts[0].marks) == 3, "a line for each seed, and their mean"
    assert part.is_wide and part.legend[-1] == (REFERENCE, "references")
    write_result(tmp_path / "page.html", content)


def test_bars_of_a_task_are_of_all_seeds():
    """Seeds earn 1 and 3 in task a."""
    cells = [
        CellResult("d", "m", seed, tuple(score("m", task, mean) for task in ("a", MEAN)), {})
        for seed, mean in ((0, 1.0), (1, 3.0))
    ]
    (part,) = study_content(cells, "first").parts
    (drawn,) = part.tasks
    (bar,) = [mark for mark in drawn.marks if mark.kind == "bar"]
    assert drawn.title == "a" and bar.points[1, 0] == 2.0


def test_names_out_of_files_stay_words(tmp_path):
    rows = [score(EVIL, EVIL), score(EVIL, MEAN)]
    log = {"phase": "adapt", "start": EVIL, "step": 0, "losses": [1.0]}
    (tmp_path / "metrics.jsonl").write_text(json.dumps(log) + "\n")
    content = run_content(results(rows, name=EVIL, config={"method": EVIL}), tmp_path)
    write_result(tmp_path / "page.html", content)
    page = (tmp_path / "page.html").read_text()
    assert "<script" not in page and "&lt;script&gt;" in page
