"""The tables under docs/results are those of the committed results."""

from pathlib import Path

import pytest

from mpdt.train.report import render_markdown
from mpdt.train.study_report import report_tables
from mpdt.train.summary import cells_csv, read_cells

ROOT = Path(__file__).parents[1]
STUDY = ROOT / "results/first-pass"


@pytest.fixture(scope="module")
def cells():
    return read_cells(STUDY)


def test_tables_are_fresh(cells):
    """Else: mpdt-train report results/first-pass -o docs/results"""
    fresh = render_markdown({"name": STUDY.name}, report_tables(cells, STUDY.name))
    assert (ROOT / "docs/results/tables.md").read_text() == fresh
    assert (ROOT / "docs/results/tables.csv").read_text() == cells_csv(cells)


def test_every_result_says_what_it_was_made_of(cells):
    for cell in cells:
        assert len(cell.content["data"]["content_hash"]) == 64
        assert cell.content["config_hash"] and cell.content["versions"]["mujoco"]
        assert cell.content["seconds"]["all"] > 0


def test_every_picture_of_the_verdicts_is_there():
    text = (ROOT / "docs/results.md").read_text()
    named = [part.split(")")[0] for part in text.split("](")[1:]]
    assert any(name.endswith(".png") for name in named)
    for name in named:
        if "://" not in name:
            assert (ROOT / "docs" / name).exists(), name
