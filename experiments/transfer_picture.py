"""What transfers: the numbers of transfer_matrix.py as one picture.

    python experiments/transfer_picture.py results/experiments/transfer/ml10.X.json FILE.svg

A chart per unseen task, in it a bar per training task's prompt; green where at least half of its
episodes were solved.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpdt.draw.chart import Axis, Chart, Dot, axis_over, row_chart
from mpdt.draw.sheet import Sheet, write_sheet
from mpdt.errors import MpdtError
from mpdt.reading import read_json

SOLVED, UNSOLVED = "c2", "c0"
WIDE, LETTERS = 520, 30


def sheet(content: dict[str, Any]) -> Sheet:
    """Prompts in the order of the matrix, all charts with the same axis of returns."""
    prompts = content["prompts"]
    everything = [number for one in prompts.values() for number in one["returns"]]
    axis = axis_over([0.0, *everything], "mean return")
    charts = [_chart(task, place, prompts, axis) for place, task in enumerate(content["tasks"])]
    legend = [(SOLVED, "solved in half of the episodes or more"), (UNSOLVED, "not solved")]
    return Sheet(f"{content['run']}: which prompt earns what on which unseen task", charts, legend,
                 columns=2)  # fmt: skip


def _chart(task: str, place: int, prompts: dict[str, Any], axis: Axis) -> Chart:
    rows = [
        (name, [Dot(SOLVED if one["successes"][place] >= 0.5 else UNSOLVED,
                    one["returns"][place])])
        for name, one in prompts.items()
    ]  # fmt: skip
    return replace(row_chart(task, rows, axis, bars=True), width=WIDE, letters=LETTERS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("matrix", type=Path, help="a file that transfer_matrix.py wrote")
    parser.add_argument("target", type=Path)
    args = parser.parse_args()
    try:
        write_sheet(args.target, sheet(read_json(args.matrix)))
    except MpdtError as error:
        sys.exit(error.render())


if __name__ == "__main__":
    main()
