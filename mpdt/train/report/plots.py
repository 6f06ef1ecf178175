"""Pictures: what every method earns, curves of training and adaptation, maps of prompts.

Needs the extra `docs`; without matplotlib nothing is drawn, and a warning says so.
"""

from __future__ import annotations

import importlib.util
import logging
import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import cycle, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mpdt.train.study.maps import KEPT, prompt_maps
from mpdt.train.study.summary import best_of_each, summarise, task_intervals

if TYPE_CHECKING:
    from mpdt.train.study.summary import CellResult

_log = logging.getLogger(__name__)
_COLOURS = {
    "-": "0.6", "nothing": "tab:purple", "task id": "tab:olive", "X": "tab:blue",
    "X+rewards": "tab:green",
    "labelled steps": "tab:orange", "demonstration": "tab:red",
}  # fmt: skip


def plot_study(cells: Sequence[CellResult], folder: Path) -> list[Path]:
    """Per data set: test tasks together and one by one, losses of training and of adaptation."""
    made = []
    for data in dict.fromkeys(cell.data for cell in cells):
        own = [cell for cell in cells if cell.data == data]
        for name, draw in _PICTURES.items():
            made += _picture(folder / f"{data}-{name}.png", partial(draw, cells=own))
    return made


def plot_kept_prompts(cells: Sequence[CellResult], results: Path, folder: Path) -> list[Path]:
    """Per data set the maps of one cell, an `MPDT-E` if there is one; of what its study kept."""
    made = []
    for data in dict.fromkeys(cell.data for cell in cells):
        own = [cell for cell in cells if cell.data == data]
        own.sort(key=lambda cell: (cell.label != "MPDT-E", cell.seed))
        kept = [results / f"{cell.content['cell']}{KEPT}" for cell in own]
        for path in [path for path in kept if path.exists()][:1]:
            made += plot_prompts(path, folder, f"{data}-prompts.png")
    return made


def plot_prompts(weights: Path, folder: Path, name: str = "prompts.png") -> list[Path]:
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
            axes.set_yticks([])
        axes.set_xlabel("embedding dimension; rows of a map are the tokens of the prompt")

    return _picture(folder / name, draw, dpi=72)  # noise does not compress


def _picture(path: Path, draw: Callable[[Any], None], dpi: int = 120) -> list[Path]:
    if importlib.util.find_spec("matplotlib") is None:
        _log.warning("no plots: matplotlib is not installed (python -m pip install 'mpdt[docs]')")
        return []
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5), layout="constrained")
    draw(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
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


def _each_task(figure: Any, cells: Sequence[CellResult]) -> None:
    """Every test task by itself: the trivial rows, and of each kind of reading the best row."""
    rows = best_of_each(summarise(cells, "test"))
    tasks = task_intervals(cells, "test")
    names = [name for name in tasks if tasks[name]]
    figure.set_figheight(1 + (0.5 + 0.2 * len(rows)) * len(names))
    panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for axes, task in zip(panels, names, strict=True):
        for place, row in enumerate(rows[::-1]):
            middle, low, high = tasks[task].get(row.method, (math.nan,) * 3)
            if math.isfinite(middle):
                ends = [[max(middle - low, 0)], [max(high - middle, 0)]]
                axes.barh(place, middle, xerr=ends, color=_COLOURS[row.reads])
        labels = [row.method if row.reads == "-" else f"{row.method} ({row.reads})" for row in rows]
        axes.set_yticks(range(len(rows)), labels[::-1], fontsize=6)
        axes.set_title(task, fontsize=8, loc="left")
        axes.axvline(0, color="black", linewidth=0.5)
    panels[-1].set_xlabel("mean return, 95 % interval")


def _training(figure: Any, cells: Sequence[CellResult]) -> None:
    """Action loss of the last training phase, mean over the seeds of a label."""
    _curves(figure, cells, "student", "action loss")


def _adaptation(figure: Any, cells: Sequence[CellResult]) -> None:
    """Alignment loss of every start, mean over the seeds of a label."""
    _curves(figure, cells, "adapt", "alignment loss")


def _curves(figure: Any, cells: Sequence[CellResult], phase: str, what: str) -> None:
    axes = figure.subplots()
    # Three dashes of ten colours: thirty lines that can be told apart.
    looks = cycle(product(("-", "--", ":"), (f"C{number}" for number in range(10))))
    seeds: dict[str, dict[float, list[float]]] = {}
    for cell in cells:
        for name, points in cell.content.get("curve", {}).items():
            if name.startswith(phase):
                losses = seeds.setdefault(" ".join([cell.label, *name.split()[1:]]), {})
                for step, loss in points:
                    losses.setdefault(step, []).append(loss)
    for label, losses in seeds.items():
        dashes, colour = next(looks)
        means = [float(np.mean(losses[step])) for step in sorted(losses)]
        axes.plot(sorted(losses), means, dashes, color=colour, label=label, linewidth=1)
    figure.set_figheight(max(5, 1 + 0.12 * len(seeds)))  # room for every name
    axes.set_yscale("log")
    axes.set_xlabel("updates")
    axes.set_ylabel(what)
    if axes.lines:
        figure.legend(fontsize=5, loc="outside right upper")


_PICTURES = {
    "tasks": _bars, "each-task": _each_task, "training": _training, "adaptation": _adaptation,
}  # fmt: skip
