"""Pictures: bars per task with intervals, curves of training and adaptation, maps of prompts.

Needs the extra `docs`; without matplotlib nothing is drawn, and a warning says so.
"""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mpdt.train.maps import prompt_maps
from mpdt.train.results import CONSTANT, MEAN, RANDOM, ZERO, Score

if TYPE_CHECKING:
    from mpdt.train.summary import CellResult

_log = logging.getLogger(__name__)


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
    """Return of every method on every test task, first seed, with its interval."""
    axes = figure.subplots()
    rows: dict[str, dict[str, Score]] = {}
    for cell in sorted(cells, key=lambda cell: cell.seed):
        for score in cell.scores:
            if score.block == "test" and score.task != MEAN and score.mean == score.mean:
                rows.setdefault(score.method, {}).setdefault(score.task, score)
    rows = {method: own for method, own in rows.items() if method not in (RANDOM, ZERO, CONSTANT)}
    tasks = list(dict.fromkeys(task for own in rows.values() for task in own))
    for number, (method, own) in enumerate(rows.items()):
        at = [i + 0.8 * (number / len(rows) - 0.5) for i, task in enumerate(tasks) if task in own]
        scores = [own[task] for task in tasks if task in own]
        below = [max(s.mean - s.low, 0) for s in scores]
        above = [max(s.high - s.mean, 0) for s in scores]
        axes.bar(at, [s.mean for s in scores], 0.8 / len(rows), yerr=[below, above], label=method)
    axes.set_xticks(range(len(tasks)), tasks)
    axes.set_ylabel("return")
    axes.legend(fontsize=6)


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
