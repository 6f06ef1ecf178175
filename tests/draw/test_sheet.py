"""A sheet by hand: where charts, legend and images stand, and that it needs no page around it."""

from xml.etree import ElementTree

import numpy as np
import pytest

from mpdt.draw.chart import WIDTH, Axis, Chart
from mpdt.draw.sheet import HEAD, IMAGE_HEIGHT, LEGEND_ROW, MARGIN, TITLE, Sheet, write_sheet
from mpdt.errors import StorageError

CHART = Chart("one", Axis(0, 1), Axis(0, 1), ())


def test_charts_stand_in_columns_and_the_next_row_below():
    sheet = Sheet("s", [CHART] * 3, columns=2)
    right, below = 2 * MARGIN + WIDTH, HEAD + 2 * TITLE + CHART.height
    assert [place[:2] for place in sheet.placed()] == [
        (MARGIN, HEAD + TITLE), (right, HEAD + TITLE), (MARGIN, below)
    ]  # fmt: skip
    assert sheet.width == right + WIDTH + MARGIN
    assert sheet.height == below + CHART.height + MARGIN


def test_a_legend_goes_on_in_the_next_row_and_moves_the_rest_down():
    sheet = Sheet("s", [CHART], [("c0", "a" * 40), ("c1", "b" * 40)])
    (_, first, *_), (x, second, *_) = sheet.entries()
    assert (x, second - first) == (MARGIN, LEGEND_ROW)
    assert next(iter(sheet.placed()))[1] == second + LEGEND_ROW / 2 + TITLE


def test_images_stand_below_and_inside(tmp_path):
    pixels = np.zeros((2, 3, 3), np.uint8)
    sheet = Sheet("s", images=[("P_c", pixels), ("P_0", pixels)])
    assert [y for _, y, _, _ in sheet.placed_images()] == [
        HEAD + TITLE, HEAD + 2 * TITLE + IMAGE_HEIGHT
    ]  # fmt: skip
    assert sheet.height == HEAD + 2 * (TITLE + IMAGE_HEIGHT) + MARGIN
    write_sheet(tmp_path / "s.svg", sheet)
    text = (tmp_path / "s.svg").read_text()
    assert text.count("data:image/webp;base64,") == 2 and "http" not in text.replace(
        "http://www.w3.org/2000/svg", ""
    )


def test_a_name_of_a_foreign_file_stays_text(tmp_path):
    write_sheet(tmp_path / "s.svg", Sheet("<script>&", [CHART], [("c0", "</svg>")]))
    root = ElementTree.parse(tmp_path / "s.svg").getroot()
    texts = [part.text for part in root.iter() if part.text]
    assert "<script>&" in texts and "</svg>" in texts
    assert not list(root.iter("{http://www.w3.org/2000/svg}script"))


def test_a_missing_folder_is_a_storage_error(tmp_path):
    with pytest.raises(StorageError, match="folder does not exist"):
        write_sheet(tmp_path / "gone" / "s.svg", Sheet("s", [CHART]))
