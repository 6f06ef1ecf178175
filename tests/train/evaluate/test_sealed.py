"""Results that somebody edited are told from those that were written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from mpdt.errors import FormatError
from mpdt.train.cli import main
from mpdt.train.evaluate.score import MEAN, Score, encode_results
from mpdt.train.evaluate.sealed import FORMAT, check_digest, sealed
from mpdt.train.run.results import find_results, read_results
from mpdt.train.study.cells import read_cell_files
from mpdt.train.study.study import encode_cell

HEADER = {
    "format": FORMAT, "name": "r", "identity": {"training": "1", "judging": "2"}, "complete": True,
    "cell": "d.m.s0", "data": {"name": "d", "content_hash": "1"},
    "config": {"method": "m", "seed": 0},
}  # fmt: skip


def scores(task: str = "a") -> list[Score]:
    return [
        Score(block="train", task=name, method="m", mean=0.1, low=0.0, high=0.2,
              normalised=float("nan"), success=0.3)
        for name in (task, MEAN)
    ]  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "results.json").write_bytes(encode_results(HEADER, scores()))
    return tmp_path


def edit(path: Path, **changes: Any) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def test_what_was_written_is_read(folder: Path) -> None:
    assert find_results(folder, HEADER["identity"]) == read_results(folder)
    text = (folder / "results.json").read_text()
    (folder / "results.json").write_text(json.dumps(json.loads(text), indent=7))
    assert read_results(folder)["name"] == "r", "the form of the text does not matter"


@pytest.mark.parametrize("key", ["scores", "format", "digest", "gone", "more"])
def test_an_edited_result_is_one_error_and_not_taken_as_done(
    folder: Path, capsys: pytest.CaptureFixture[str], key: str
) -> None:
    path, content = folder / "results.json", read_results(folder)
    if key == "scores":
        content["scores"][0]["success"] = 7.0
    elif key == "gone":
        del content["digest"]
    else:
        content[key] = "mpdt-results/1" if key == "format" else "x"
    path.write_text(json.dumps(content))
    with pytest.raises(SystemExit) as stop:
        main(["report", str(folder)])
    out, error = capsys.readouterr()
    assert (stop.value.code, out) == (1, "")
    assert error.startswith(f"error: {path}: changed after it was written; expected")
    assert "judges the run again" in error
    assert find_results(folder, HEADER["identity"]) is None


def test_results_from_before_there_were_digests_are_read(folder: Path) -> None:
    path, content = folder / "results.json", read_results(folder)
    del content["digest"]
    for old in ("mpdt-results/1", None):
        content["format"] = old
        path.write_text(json.dumps({k: v for k, v in content.items() if v is not None}))
        assert read_results(folder)["name"] == "r"


def test_an_edited_cell_is_one_error(tmp_path: Path) -> None:
    path = tmp_path / "d.m.s0.json"
    path.write_bytes(encode_cell(json.loads(encode_results(HEADER, scores()))))
    ((file, _),) = read_cell_files([path])
    assert file.cell == "d.m.s0"
    edit(path, config={"method": "m", "seed": 0, "more": 1})
    with pytest.raises(FormatError, match="changed after it was written") as caught:
        list(read_cell_files([path]))
    assert "its study makes it again" in caught.value.hint


def test_tables_show_brackets_and_escapes_as_text(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "results.json").write_bytes(encode_results(HEADER, scores("[/x] :smile: \x1b[31m")))
    with pytest.raises(SystemExit) as stop:
        main(["report", str(folder)])
    out = capsys.readouterr().out
    assert stop.value.code == 0 and "[/x] :smile: \\x1b[31m" in out


def test_a_digest_is_of_values() -> None:
    content = {"b": [1.0, 2, None, "ä"], "a": {"x": 1e-300, "y": 10**30}}
    assert sealed({"a": content["a"], "b": content["b"]})["digest"] == sealed(content)["digest"]
    check_digest(json.loads(json.dumps(sealed(content))), "x", "")
    assert sealed(sealed(content)) == sealed(content)
