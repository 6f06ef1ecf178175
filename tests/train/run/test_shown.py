"""Results in a notebook: the tables of the report, as HTML."""

import json

import pytest

import mpdt
from mpdt.errors import MissingFileError
from mpdt.train.evaluate.score import MEAN, Score, encode_results
from mpdt.train.run.results import Results


def test_results_show_their_tables(tmp_path):
    scores = [Score(block="test", task=task, method="<mine>", mean=1.5, low=1.0, high=2.0,
                    normalised=0.25, reads="X", num_episodes=5)
              for task in ("left", MEAN)]  # fmt: skip
    (tmp_path / "results.json").write_bytes(encode_results({"format": "mpdt-results/2"}, scores))
    found = mpdt.read_results(str(tmp_path))
    assert isinstance(found, Results) and json.loads(json.dumps(found)) == found
    shown = found._repr_html_()
    assert shown.count("<table>") == 2 and "1.5 [1.0, 2.0] (0.25)" in shown
    assert "&lt;mine&gt;" in shown and "<mine>" not in shown


def test_a_file_is_no_run(tmp_path):
    (tmp_path / "data.h5").touch()
    for name in ("data.h5", "nowhere"):
        with pytest.raises(MissingFileError, match="no folder of a run"):
            mpdt.read_results(tmp_path / name)
