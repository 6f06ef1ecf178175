"""Pictures of a study: bars per task with intervals, learning curves. Needs the extra `docs`."""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mpdt.train.results import CONSTANT, MEAN, RANDOM, ZERO, Score

if TYPE_CHECKING:
    from mpdt.train.summary import CellResult

_log = logging.getLogger(__name__)


def plot_study(cells: Sequence[CellResult], folder: Path) -> list[Path]:
    """One picture of test tasks and one of losses per data set; none without matplotlib."""
    if importlib.util.find_spec("matplotlib") is None:
        _log.warning("no plots: matplotlib is not installed (python -m pip install 'mpdt[docs]')")
        return []
    from matplotlib.figure import Figure

    made = []
    for data in dict.fromkeys(cell.data for cell in cells):
        own = [cell for cell in cells if cell.data == data]
        for name, draw in (("tasks", _bars), ("curves", _curves)):
            figure = Figure(figsize=(9, 5), layout="constrained")
            draw(figure, own)
            figure.suptitle(data)
            path = folder / f"{data}-{name}.png"
            figure.savefig(path, dpi=120)
            made.append(path)
    return made


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


def _curves(figure: Any, cells: Sequence[CellResult]) -> None:
    """Action loss of the last training phase of every cell."""
    axes = figure.subplots()
    for cell in cells:
        for phase, points in cell.content.get("curve", {}).items():
            if phase == "student":
                steps, losses = zip(*points, strict=True)
                axes.plot(steps, losses, label=f"{cell.label} s{cell.seed}", linewidth=1)
    axes.set_yscale("log")
    axes.set_xlabel("updates")
    axes.set_ylabel("action loss")
    axes.legend(fontsize=6)
