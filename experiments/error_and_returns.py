"""Does a smaller action error mean a larger return? Rank correlation over the cells of a study.

    python experiments/error_and_returns.py results/studies/one-block

Of each family Spearman's rho of minus the error and the return over all methods and seeds: +1 = the
smaller the error the larger the return. Of test tasks the best row that reads no labelled step.
A cell whose run had `--validation` brings the error on held-out episodes; one without brings the
training's own last action loss, which is not the same thing: the table says which.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from scipy.stats import spearmanr

from mpdt.draw.table import markdown_table
from mpdt.errors import MpdtError, UsageError
from mpdt.train.evaluate.score import MEAN, REFERENCES, Block
from mpdt.train.fit.validation import PHASE as VALIDATION
from mpdt.train.study.cells import CellResult
from mpdt.train.study.summary import read_cells

FREE = ("nothing", "X", "X+rewards", "task id", None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    try:
        cells = read_cells(folder)
        if not cells:
            raise UsageError("no results of a study", where=str(folder))
    except MpdtError as error:
        sys.exit(error.render())
    rows = [
        (data, block, error, len(pairs), *map("{:.2f}".format, correlation(pairs)))
        for data in dict.fromkeys(cell.data for cell in cells)
        for error in (VALIDATION, "student")
        for block in ("train", "test")
        if len(pairs := list(pairs_of(cells, data, error, block))) > 3  # type: ignore[arg-type]
    ]
    print(markdown_table(("data", "tasks", "error", "cells", "rho", "p"), rows))


def correlation(pairs: Sequence[tuple[float, float]]) -> tuple[float, float]:
    found = spearmanr([-error for error, _ in pairs], [reached for _, reached in pairs])
    return float(found.statistic), float(found.pvalue)


def pairs_of(
    cells: Sequence[CellResult], data: str, error: str, block: Block
) -> Iterator[tuple[float, float]]:
    """(last error, mean return) of each cell that has both."""
    for cell in cells:
        points = cell.content.get("curve", {}).get(error)
        returns = [
            score.mean for score in cell.scores
            if score.block == block and score.task == MEAN and score.method not in REFERENCES
            and score.reads in FREE
        ]  # fmt: skip
        if cell.data == data and points and returns:
            yield points[-1][1], max(returns)


if __name__ == "__main__":
    main()
