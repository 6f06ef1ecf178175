"""Studies: cells run once, are found again, and fail one by one; their tables by hand."""

import copy
import json
import math
import threading
from contextlib import contextmanager
from dataclasses import replace

import pytest

from mpdt.disk import holding
from mpdt.errors import FormatError, UsageError
from mpdt.train.cli import main
from mpdt.train.evaluate.score import MEAN, Score, encode_results
from mpdt.train.run.progress import Progress
from mpdt.train.study import plans as studies
from mpdt.train.study import study
from mpdt.train.study.cells import CellResult
from mpdt.train.study.plans import STUDIES, get_study
from mpdt.train.study.recipes import Cell
from mpdt.train.study.study import Places, configure, encode_cell, inspect_cell, run_study
from mpdt.train.study.summary import (
    best_of_each,
    cells_csv,
    is_study,
    read_cells,
    study_tables,
    summarise,
    task_intervals,
)

TINY = {
    "inputs": {"time_table": 16}, "evaluation": {"horizon": 3, "episodes": 2},
    "statistics": {"batches": 1}, "adapt": {"steps": 1}, "multitask": {"steps": 2},
}  # fmt: skip
ONE = Cell("tiny", "Soft-Prompt-TTA", preset="smoke", changes=TINY)
TWO = Cell("tiny", "MPDT-no-distillation", 1, "short", "smoke", TINY)
BROKEN = Cell("tiny", "Soft-Prompt", preset="smoke", changes=TINY | {"sampler": {"window": 300}})
ABSENT = Cell("nowhere", "MPDT", preset="smoke")


@pytest.fixture
def places(tiny_file, tmp_path):
    return Places(tiny_file.parent, tmp_path / "runs", tmp_path / "results")


@contextmanager
def held_elsewhere(path):
    begun, over = threading.Event(), threading.Event()

    def hold():
        with holding(path):
            begun.set()
            over.wait(60)

    thread = threading.Thread(target=hold)
    thread.start()
    assert begun.wait(60)
    try:
        yield
    finally:
        over.set()
        thread.join()


def states(cells, places, restart=False):
    outcomes = run_study(cells, places, Progress(quiet=True), restart)
    return [(outcome.cell.name, outcome.state) for outcome in outcomes]


def test_cells_are_run_skipped_failed_and_left_out(places):
    """A failure is told and the next cell runs; the second call runs nothing."""
    first = states([ONE, BROKEN, TWO, ABSENT], places)
    assert [state for _, state in first] == ["done", "failed", "done", "no data"]
    assert first[2][0] == "tiny.short.s1"
    stored = sorted(path.name for path in places.results.iterdir())
    assert stored == [
        "tiny.Soft-Prompt-TTA.s0.json", "tiny.short.s1.json", "tiny.short.s1.prompts.safetensors"
    ]  # fmt: skip
    with held_elsewhere(places.runs / "tiny.other.s0"):
        other = replace(ONE, label="other")
        assert states([other, ONE], places) == [("tiny.other.s0", "busy"), (ONE.name, "done")]
    before = (places.runs / "tiny.short.s1/weights.safetensors").stat().st_mtime_ns
    assert [s for _, s in states([ONE, TWO], places)] == ["done", "done"]
    assert (places.runs / "tiny.short.s1/weights.safetensors").stat().st_mtime_ns == before


def test_a_done_cell_can_be_made_again_to_the_same_scores(places):
    states([TWO], places)
    weights, result = places.runs / "tiny.short.s1/weights.safetensors", places.result(TWO)
    before, scores = weights.stat().st_mtime_ns, json.loads(result.read_text())["scores"]
    assert states([TWO], places, restart=True) == [("tiny.short.s1", "done")]
    assert weights.stat().st_mtime_ns != before
    assert json.loads(result.read_text())["scores"] == scores


def test_a_damaged_data_file_fails_its_own_cell(tiny_file, places, tmp_path, monkeypatch, capsys):
    """In a run and in a dry one, where the next cell is looked at as well."""
    (tmp_path / "data").mkdir()
    (tmp_path / "data/tiny.h5").symlink_to(tiny_file)
    (tmp_path / "data/bad.h5").write_bytes(b"garbage" * 99)
    bad = Cell("bad", "Soft-Prompt-TTA", preset="smoke", changes=TINY)
    placed = Places(tmp_path / "data", places.runs, places.results)
    assert states([bad, ABSENT], placed) == [(bad.name, "failed"), (ABSENT.name, "no data")]
    monkeypatch.setattr(studies, "STUDIES", {"try": (bad, ONE)})
    assert call("study", "try", "--data-dir", tmp_path / "data", "--dry-run") == 1
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("failed   bad.Soft-Prompt-TTA.s0") and "bad.h5" in first
    assert second == "to do    tiny.Soft-Prompt-TTA.s0"


def test_a_result_says_what_made_it(places):
    states([TWO], places)
    content = json.loads(places.result(TWO).read_text())
    assert content["cell"] == "tiny.short.s1" and content["config"]["seed"] == 1
    assert content["config"]["method"] == "short" and len(content["config_hash"]) == 64
    assert {"torch", "mujoco", "mpdt"} <= content["versions"].keys()
    assert content["data"]["content_hash"] and content["seconds"]["all"] >= 0
    assert [step for step, _ in content["curve"]["student"]] == [2]


def test_other_settings_or_data_are_not_done(places):
    states([ONE], places)
    other = Cell("tiny", "Soft-Prompt-TTA", preset="smoke", changes=TINY | {"adapt": {"lr": 0.1}})
    outcome = inspect_cell(other, places)
    assert (outcome.state, outcome.note) == ("to do", "its result is of other settings or data")
    away = Places(places.data / "gone", places.runs, places.results)
    assert inspect_cell(ONE, away).note == "data file not here: content not compared"
    assert states([ONE], away) == [(ONE.name, "done")]
    assert states([ONE], away, restart=True) == [(ONE.name, "no data")], "it cannot be made again"
    assert inspect_cell(other, away).state == "no data"


def test_shipped_studies_are_possible():
    """Every cell's settings exist and fit their types; names are unique."""
    for name in STUDIES:
        cells = get_study(name)
        assert len({cell.name for cell in cells}) == len(cells)
        for cell in cells:
            assert configure(cell).seed == cell.seed
    with pytest.raises(UsageError, match="unknown study 'frist-pass'"):
        get_study("frist-pass")


def test_one_block_cuts_language_models_and_nothing_else():
    """Prompt-DT and its like have three blocks of their own, whatever a study says of depth."""
    small = {"Prompt-DT", "Prompt-DT-TTA", "MT-BC-FT", "MT-ORL-FT", "HDT"}
    for cell in get_study("one-block"):
        assert configure(cell).backbone.depth == (None if cell.method in small else 1), cell.name


def call(*arguments):
    with pytest.raises(SystemExit) as stopped:
        main([str(argument) for argument in arguments])
    return stopped.value.code


def test_one_cell_per_data_set_keeps_its_prompts(places, monkeypatch):
    """It keeps them anew when it is run again."""
    monkeypatch.setattr(study, "run_pipeline", lambda *arguments: {"scores": []})
    monkeypatch.setattr(study, "keep_prompts", lambda weights, path: path.write_text(str(weights)))
    second = replace(TWO, seed=2)
    states([TWO, second], places, restart=True)
    assert places.prompts(TWO).exists() and not places.prompts(second).exists()
    places.prompts(TWO).write_text("of before")
    states([TWO], places, restart=True)
    assert places.prompts(TWO).read_text() != "of before"
    assert places.may_keep_prompts(replace(TWO, data="other")), "another data set has its own"


def test_study_and_report_as_typed(places, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(studies, "STUDIES", {"try": (ONE, ABSENT)})
    folders = ["--data-dir", places.data, "--runs-dir", tmp_path, "--results-dir", tmp_path / "r"]
    assert call("study", "try", *folders, "--dry-run") == 0
    assert capsys.readouterr().out.splitlines()[0] == "to do    tiny.Soft-Prompt-TTA.s0"
    assert call("study", "try", *folders, "--only", "tiny", "-q") == 0
    assert capsys.readouterr().out == "done     tiny.Soft-Prompt-TTA.s0\n"
    assert call("report", tmp_path / "r/try", "-o", tmp_path / "out") == 0
    out = capsys.readouterr().out
    assert "tiny: test tasks" in out and "from cross, adapted" in out
    assert "tiny: test tasks" in (tmp_path / "out/tables.md").read_text()
    assert (tmp_path / "out/tables.csv").read_text().startswith("data,cell,seed,method,block")
    assert call("report", tmp_path / "r/try", "-o", tmp_path / "too", "--json") == 0
    assert json.loads(capsys.readouterr().out)[0]["cell"] == "tiny.Soft-Prompt-TTA.s0"
    assert (tmp_path / "too/tables.md").exists()
    assert call("study", "tyr", *folders) == 2


def cell(seed, *means, label="m", data="d"):
    scores = [
        Score(block="test", task=task, method=f"{label} infer", mean=value, low=value - 1,
              high=value + 1, normalised=value / 10, reads="X+rewards")
        for task, value in zip(("a", "b", MEAN), (*means, sum(means) / 2), strict=True)
    ]  # fmt: skip
    zero = [msgspec_replace(score, method="zero action", mean=0.0, reads=None) for score in scores]
    return CellResult(data, label, seed, (*zero, *scores), {})


def msgspec_replace(score, **changes):
    import msgspec

    return msgspec.structs.replace(score, **changes)


def test_seeds_are_put_together_by_hand():
    """Means 2 and 4 of one seed, 4 and 6 of the other: 4; normalised 0.2 0.4 0.4 0.6: IQM 0.4.

    Seeds earn 3 and 5; their spread over sqrt(2) is 1, and t(1) is 12.706.
    """
    zero, row = summarise([cell(0, 2.0, 4.0), cell(1, 4.0, 6.0)], "test")
    assert (row.method, row.num_seeds, row.reads) == ("m infer", 2, "X+rewards")
    assert row.mean == 4.0 and row.iqm == pytest.approx(0.4)
    assert row.interval == pytest.approx((4 - 12.706, 4 + 12.706), abs=1e-3)
    assert zero.method == "zero action" and zero.num_seeds == 1, "references once"


def test_a_row_says_which_numbers_its_runs_were_trained_in():
    """bfloat16 and float32 are other processors and other weights: mixed seeds are told."""
    cells = [replace(cell(seed, 2.0, 4.0), content={"backbone": {"dtype": dtype}})
             for seed, dtype in enumerate(("float32", "float32", "bfloat16"))]  # fmt: skip
    found = [summarise(some, "test")[1].dtype for some in (cells[:1], cells[:2], cells)]
    assert found == ["float32", "float32", "both"]
    assert study_tables(cells)[0].rows[1][-2:] == ("both", "3")


def test_one_seed_has_the_interval_of_its_episodes_and_none_of_runs():
    _, row = summarise([cell(0, 2.0, 4.0)], "test")
    assert row.interval == (2.0, 4.0) and math.isnan(row.iqm_interval[0])


def test_task_by_task_seeds_are_put_together_and_references_are_not():
    """Task b: 4 of one seed, 6 of the other. One seed alone keeps the interval of its episodes."""
    both = task_intervals([cell(0, 2.0, 4.0), cell(1, 4.0, 6.0)], "test")
    assert both["b"]["zero action"] == (0.0, 3.0, 5.0)
    assert both["b"]["m infer"] == pytest.approx((5.0, 5 - 12.706, 5 + 12.706), abs=1e-3)
    assert task_intervals([cell(1, 4.0, 6.0)], "test")["b"]["m infer"] == (6.0, 5.0, 7.0)


def test_one_episode_per_task_has_no_interval():
    """Its resampling gives the mean each time; that is not certainty."""
    once = cell(0, 2.0, 4.0)
    scores = tuple(msgspec_replace(s, low=s.mean, high=s.mean) for s in once.scores)
    once = CellResult("d", "m", 0, scores, {})
    assert math.isnan(summarise([once], "test")[1].interval[0])
    assert math.isnan(task_intervals([once], "test")["b"]["m infer"][1])


def test_the_best_of_each_kind_of_reading_stays():
    cells = [cell(0, 2.0, 4.0), cell(0, 1.0, 3.0, label="worse"), cell(0, 3.0, 5.0, label="best")]
    assert [row.method for row in best_of_each(summarise(cells, "test"))] == [
        "zero action", "best infer"
    ]  # fmt: skip


def test_tables_tell_what_was_not_run(monkeypatch):
    monkeypatch.setitem(STUDIES, "s", (Cell("d", "m"), Cell("d", "m", 1), Cell("e", "m")))
    (table,) = study_tables([cell(0, 2.0, 4.0)], "s")
    assert table.notes == ("not run: d.m.s1", "no cell run: e")
    assert table.rows[1] == ("m infer", "3.0", "[2.0, 4.0]", "0.30", "-", "X+rewards", "-", "1")
    assert table.rows[0][-2:] == ("-", "-"), "zero action"
    line = cells_csv([cell(0, 2.0, 4.0)]).splitlines()[4]
    assert line == "d,m,0,m infer,test,a,2.0,1.0,3.0,0.2,,X+rewards"


def test_what_is_no_result_is_one_error(tmp_path):
    (tmp_path / "x.json").write_text("{}")
    assert is_study(tmp_path)
    with pytest.raises(FormatError, match="not the result of a cell"):
        read_cells(tmp_path)
    (tmp_path / "results.json").write_text("{}")
    assert not is_study(tmp_path)


@pytest.fixture
def stored(tmp_path):
    """Two seeds of a method on disk, and a way to spoil the first."""
    whole = {
        seed: {"cell": f"d.m.s{seed}", "data": {"name": "d", "content_hash": "1"},
               "config": {"method": "m", "seed": seed}, "curve": {"student": [[1, 0.5]]},
               "inferred": {}, "more": None,
               "scores": json.loads(encode_results({}, cell(seed, 2.0, 4.0).scores))["scores"]}
        for seed in (0, 1)
    }  # fmt: skip

    def write(spoil=lambda _: None):
        content = copy.deepcopy(whole)
        spoil(content[0])
        for seed, one in content.items():
            (tmp_path / f"d.m.s{seed}.json").write_bytes(encode_cell(one))
        return tmp_path

    return write


def test_whole_cells_are_read(stored):
    first, second = read_cells(stored())
    assert (first.data, first.label, first.seed, second.seed) == ("d", "m", 0, 1)
    assert first.scores == cell(0, 2.0, 4.0).scores and first.content["more"] is None


@pytest.mark.parametrize(
    ("spoil", "told"),
    [(lambda c: c["scores"].pop(), "m infer has no mean over its test tasks"),
     (lambda c: c["scores"].__delitem__(slice(3, 5)), "m infer has no test task beside the mean"),
     (lambda c: c["scores"].append(c["scores"][3]), "m infer has a test task twice; found a"),
     (lambda c: c["scores"].__setitem__(0, 3), "Expected `object`, got `int` - at `$[0]`"),
     (lambda c: c["scores"][0].update(mean="1"), "Expected `float`, got `str` - at `$[0].mean`"),
     (lambda c: c["scores"].clear(), "length >= 1 - at `$.scores`"),
     (lambda c: c.update(curve={"student": [3]}), "got `int` - at `$.curve[...][0]`"),
     (lambda c: c.update(curve={"student": []}), "length >= 1 - at `$.curve[...]`"),
     (lambda c: c.update(curve=[[1, 2]]), "Expected `object`, got `array` - at `$.curve`"),
     (lambda c: c["config"].update(seed="0"), "Expected `int`, got `str` - at `$.config.seed`"),
     (lambda c: c["config"].pop("method"), "required field `method` - at `$.config`"),
     (lambda c: c["data"].pop("content_hash"), "required field `content_hash`"),
     (lambda c: c["data"].update(name="../d"), "matching regex"),
     (lambda c: c.pop("cell"), "required field `cell`"),
     (lambda c: c.update(inferred=3), "Expected `object`, got `int` - at `$.inferred`"),
     (lambda c: c["scores"].pop(3), "d.m.s1.json: other test tasks of "
      "m infer than d.m.s0.json; found in one of them only: a"),
     (lambda c: c["data"].update(content_hash="2"), "d.m.s1.json: other episodes of d than "
      "d.m.s0.json; expected 2, found 1"),
     (lambda c: c["config"].update(seed=1), "d.m.s1.json: a second file of d.m.s1; found also "
      "d.m.s0.json")],
)  # fmt: skip
def test_damaged_cells_are_one_error(stored, spoil, told, tmp_path, capsys):
    assert call("report", stored(spoil), "--html", tmp_path / "page.html") == 1
    out, error = capsys.readouterr()
    assert out == "" and error.startswith("error: ") and told in error
    assert error.count("\n") == 2 and "hint:  " in error
