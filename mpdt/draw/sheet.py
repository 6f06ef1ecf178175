"""Sheet: charts below and beside each other as one SVG file, which any page can link to.

It brings its own colours, light and dark, and paper under them; what a page would show when
pointed at has to be written out, because a linked picture shows nothing of the kind.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from mpdt.draw.chart import LETTER, Chart
from mpdt.draw.html import TEMPLATES, picture, render, write_page

MARGIN, TITLE, HEAD = 12, 22, 34  # around everything; above a chart; above all of them
LEGEND_ROW, SWATCH, GAP = 18, 15, 18
IMAGE_HEIGHT = 56


@dataclass(frozen=True)
class Sheet:
    """What is on one picture, in units of its width.

    Args:
        legend: (key, text) of the colours.
        columns: charts beside each other; all are as wide as the first.
        images: named pixels (H, W, 3), each drawn over the whole width, below the charts.
        least_width: of the picture, where charts do not fill it.
    """

    title: str
    charts: Sequence[Chart] = ()
    legend: Sequence[tuple[str, str]] = ()
    columns: int = 1
    images: Sequence[tuple[str, npt.NDArray[np.uint8]]] = ()
    least_width: float = 340
    margin: float = MARGIN
    image_height: float = IMAGE_HEIGHT

    @property
    def width(self) -> float:
        wide = self.charts[0].width if self.charts else 0.0
        columns = min(self.columns, len(self.charts))
        return max(self.least_width, columns * (wide + MARGIN) + MARGIN)

    @property
    def height(self) -> float:
        images = len(self.images) * (IMAGE_HEIGHT + TITLE)
        return self._below_legend() + sum(self._row_heights()) + images + MARGIN

    def entries(self) -> Iterator[tuple[float, float, str, str]]:
        """x, y, key and text of the legend, from left to right and on in the next row."""
        x, y = float(MARGIN), float(HEAD + LEGEND_ROW / 2)
        for key, text in self.legend:
            needed = SWATCH + LETTER * len(text)
            if x > MARGIN and x + needed > self.width - MARGIN:
                x, y = float(MARGIN), y + LEGEND_ROW
            yield round(x, 1), y, key, text
            x += needed + GAP

    def placed(self) -> Iterator[tuple[float, float, Chart]]:
        """Upper left corner of every chart."""
        top = self._below_legend()
        heights = self._row_heights()
        for number, chart in enumerate(self.charts):
            row, column = divmod(number, self.columns)
            x = MARGIN + column * (self.charts[0].width + MARGIN)
            yield x, top + sum(heights[:row]) + TITLE, chart

    def placed_images(self) -> Iterator[tuple[float, float, str, str]]:
        """Upper left corner, name and address of every image."""
        top = self._below_legend() + sum(self._row_heights())
        for number, (name, pixels) in enumerate(self.images):
            y = top + number * (IMAGE_HEIGHT + TITLE) + TITLE
            yield MARGIN, y, name, picture(pixels, lossless=True)

    def _below_legend(self) -> float:
        lines = [y for _, y, _, _ in self.entries()]
        return lines[-1] + LEGEND_ROW / 2 if lines else float(HEAD)

    def _row_heights(self) -> list[float]:
        rows = [self.charts[i : i + self.columns] for i in range(0, len(self.charts), self.columns)]
        return [TITLE + max(chart.height for chart in row) for row in rows]


def write_sheet(target: Path, sheet: Sheet) -> None:
    """Raises: StorageError where the disk refuses; the old picture stays."""
    write_page(target, render("sheet.svg", TEMPLATES, sheet=sheet))
