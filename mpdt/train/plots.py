"""Pictures: what every method earns, curves of training and adaptation, maps of prompts.

Needs the extra `docs`; without matplotlib nothing is drawn, and a warning says so.
"""

from __future__ import annotations

import importlib.util
import logging
import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mpdt.train.maps import prompt_maps
from mpdt.train.summary import summarise

if TYPE_CHECKING:
    from mpdt.train.summary import CellResult

_log = logging.getLogger(__name__)
_COLOURS = {
    "-": "0.6", "nothing": "tab:purple", "X": "tab:blue", "X+rewards": "tab:green",
    "labelled steps": "tab:orange", "demonstration": "tab:red",
}  # fmt: skip


def plot_study(cells: Sequence[CellResult], folder: Path) -> list[Path]:
    """Per data set: test tasks, losses of training, losses of adaptation."""
    made = []
    for data in dict.fromkeys(cell.data for cell in cells):
        own = [cell for cell in cells if cell.data == data]
        for name, draw in (("tasks", _bars), ("training", _training), ("adaptation", _adaptation)):
            made += _picture(folder / f"{data}-{name}.png", partial(draw, cells=own))
    return made


def plot_prompts(weights: Path, folder: Path) -> list[Path]:
    """P_c and the first P_k of a trained run as maps (l, s); nothing for prompts of other kinds."""
    maps = prompt_maps(weights)
    if not maps:
        return []

    def draw(figure: Any) -> None:
        for axes, (name, values) in zip(
            figure.subplots(len(maps), 1, sharex=True), maps.items(), strict=True
        ):
            size = float(np.quantile(np.abs(values), 0.99))
            axes.imshow(values, aspect="auto", cmap="RdBu", vmin=-size, vmax=size)
            axes.set_ylabel(name)

    return _picture(folder / "prompts.png", draw)


def _picture(path: Path, draw: Callable[[Any], None]) -> list[Path]:
    if importlib.util.find_spec("matplotlib") is None:
        _log.warning("no plots: matplotlib is not installed (python -m pip install 'mpdt[docs]')")
        return []
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5), layout="constrained")
    draw(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    return [path]


def _bars(figure: Any, cells: Sequence[CellResult]) -> None:
    """Mean over the test tasks of every row, the trivial ones too, coloured by what was read."""
    rows = [row for row in summarise(cells, "test") if math.isfinite(row.mean)]
    rows.sort(key=lambda row: row.mean)
    figure.set_figheight(1 + 0.22 * len(rows))
    axes = figure.subplots()
    for reads in dict.fromkeys(row.reads for row in rows):
        own = [(place, row) for place, row in enumerate(rows) if row.reads == reads]
        ends = [
            [max(row.mean - row.interval[0], 0) for _, row in own],
            [max(row.interval[1] - row.mean, 0) for _, row in own],
        ]
        axes.barh([place for place, _ in own], [row.mean for _, row in own], xerr=ends,
                  color=_COLOURS[reads], label="reference" if reads == "-" else reads)  # fmt: skip
    axes.set_yticks(range(len(rows)), [row.method for row in rows], fontsize=7)
    axes.set_xlabel("mean return on the test tasks, 95 % interval")
    axes.axvline(0, color="black", linewidth=0.5)
    figure.legend(title="reads", loc="outside right upper", fontsize=7)


def _training(figure: Any, cells: Sequence[CellResult]) -> None:
    """Action loss of the last training phase of every cell."""
    _curves(figure, cells, "student", "action loss")


def _adaptation(figure: Any, cells: Sequence[CellResult]) -> None:
    """Alignment loss of every start of every cell."""
    _curves(figure, cells, "adapt", "alignment loss")


def _curves(figure: Any, cells: Sequence[CellResult], phase: str, what: str) -> None:
    axes = figure.subplots()
    for cell in cells:
        for name, points in cell.content.get("curve", {}).items():
            if name.startswith(phase):
                steps, losses = zip(*points, strict=True)
                label = " ".join([cell.label, f"s{cell.seed}", *name.split()[1:]])
                axes.plot(steps, losses, label=label, linewidth=1)
    axes.set_yscale("log")
    axes.set_xlabel("updates")
    axes.set_ylabel(what)
    if axes.lines:
        axes.legend(fontsize=6)
