"""The tables under docs/results are those of the committed results, and those of their studies."""

from pathlib import Path

import pytest

from mpdt.draw.table import markdown_page
from mpdt.train.evaluate.tables import NORMALISED
from mpdt.train.report.pictures import draw_study
from mpdt.train.report.study_tables import report_tables
from mpdt.train.run.identity import plain_settings
from mpdt.train.study.plans import STUDIES
from mpdt.train.study.study import config_hash, configure
from mpdt.train.study.summary import cells_csv, read_cells, studies_in

ROOT = Path(__file__).parents[1]
PAGES = ROOT / "docs/results"
STUDIED = [folder.name for folder in studies_in(ROOT / "results/studies")]


@pytest.fixture(scope="module")
def cells():
    return read_cells(ROOT / "results/studies")


def test_tables_are_fresh(cells):
    """Else: make results"""
    fresh = markdown_page({"name": "studies"}, report_tables(cells, STUDIED), NORMALISED)
    assert (PAGES / "tables.md").read_text() == fresh
    assert (PAGES / "tables.csv").read_text() == cells_csv(cells)


@pytest.mark.parametrize("data", ["mt10", "mt50"])  # few tasks, and many
def test_a_picture_is_fresh(cells, tmp_path, data):
    """Two stand for all, which take a minute. Else: make results"""
    own = [cell for cell in cells if cell.data == data]
    for path in draw_study(own, tmp_path):
        assert (PAGES / path.name).read_text() == path.read_text(), path.name


def test_every_result_is_of_the_settings_its_study_has_now(cells):
    """A preset or method that changes must not change what a stored result says it was."""
    wanted = {cell.name: config_hash(plain_settings(configure(cell)))
              for study in STUDIED for cell in STUDIES[study]}  # fmt: skip
    for cell in cells:
        assert cell.content["config_hash"] == wanted[cell.content["cell"]], cell.content["cell"]


def test_every_result_says_what_it_was_made_of(cells):
    for cell in cells:
        assert len(cell.content["data"]["content_hash"]) == 64
        assert cell.content["config_hash"] and cell.content["versions"]["mujoco"]
        assert cell.content["seconds"]["all"] > 0


def test_every_picture_of_the_verdicts_is_there():
    text = (ROOT / "docs/results.md").read_text()
    named = [part.split(")")[0] for part in text.split("](")[1:]]
    assert any(name.endswith(".svg") for name in named)
    for name in named:
        if "://" not in name and not name.startswith("#"):
            assert (ROOT / "docs" / name).exists(), name
