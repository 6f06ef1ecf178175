"""Pictures of a study as SVG files: what every method earns, what was lost on the way, prompts.

DATA-tasks.svg        mean over the test tasks of every row, coloured by what was read
DATA-each-task.svg    every test task: the trivial rows, and of each kind of reading the best; a row
                      of dots for each where there are many
DATA-trials.svg       return and success over the number of own episodes, a line per row
DATA-training.svg     action loss, one chart per method, its seeds thin and their mean thick
DATA-adaptation.svg   alignment loss likewise, one chart per method and start
DATA-prompts.svg      maps of P_c and the first P_k of one cell
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mpdt.disk import disk
from mpdt.draw.chart import Axis, Chart, Dot, Mark, axis_over, line, row_chart
from mpdt.draw.sheet import Sheet, write_sheet
from mpdt.train.evaluate.score import REFERENCES, Block
from mpdt.train.report.charts import REFERENCE, Points
from mpdt.train.study.cells import CellResult
from mpdt.train.study.maps import KEPT, map_pixels, prompt_maps
from mpdt.train.study.protocols import split_own
from mpdt.train.study.summary import Row, best_of_each, summarise, task_intervals

MANY_TASKS = 12
WIDE, LETTERS = 720, 48  # names are written out: nothing is told by pointing at a linked picture
COLOURS = {
    "nothing": "c3", "task id": "c6", "X": "c0", "X+rewards": "c2", "labelled steps": "c1",
    "demonstration": "c4", "trials": "c5", "X+rewards, trials": "c7",
}  # fmt: skip
"""CSS key of what was read; references are grey."""
OWN = "c8"
"""Of training tasks nothing has to be read."""


def draw_study(cells: Sequence[CellResult], folder: Path) -> list[Path]:
    """All pictures but the prompts of every data set; those with nothing to show are left out.

    Raises: StorageError where the disk refuses.
    """
    made = []
    for data in dict.fromkeys(cell.data for cell in cells):
        own = [cell for cell in cells if cell.data == data]
        for name, draw in _PICTURES.items():
            sheet = draw(data, own)
            if sheet.charts:
                made.append(_write(folder / f"{data}-{name}.svg", sheet))
    return made


def draw_kept_prompts(cells: Sequence[CellResult], results: Path, folder: Path) -> list[Path]:
    """Per data set the maps of one cell, an `MPDT-E` if there is one; of what its study kept."""
    made = []
    for data in dict.fromkeys(cell.data for cell in cells):
        own = [cell for cell in cells if cell.data == data]
        own.sort(key=lambda cell: (cell.label != "MPDT-E", cell.seed))
        kept = [results / f"{cell.content['cell']}{KEPT}" for cell in own]
        for path in [path for path in kept if path.exists()][:1]:
            title = f"{data}: prompts of {path.name.removesuffix(KEPT)}"
            made += draw_prompts(path, folder, f"{data}-prompts.svg", title)
    return made


def draw_prompts(
    weights: Path, folder: Path, name: str = "prompts.svg", title: str = "prompts"
) -> list[Path]:
    """P_c and the first P_k of a trained run as maps (l, s); nothing for prompts of other kinds.

    Raises: FormatError for damaged weights; StorageError.
    """
    maps = [(name, map_pixels(values)) for name, values in prompt_maps(weights).items()]
    if not maps:
        return []
    told = [("c0", "below zero"), ("c4", "above; a row per token, a column per dimension")]
    return [_write(folder / name, Sheet(title, legend=told, images=maps, least_width=WIDE))]


def _write(target: Path, sheet: Sheet) -> Path:
    with disk(target):
        target.parent.mkdir(parents=True, exist_ok=True)
    write_sheet(target, sheet)
    return target


def tasks_sheet(data: str, cells: Sequence[CellResult], block: Block = "test") -> Sheet:
    """All rows, the largest mean first."""
    rows = [row for row in summarise(cells, block) if math.isfinite(row.mean)]
    rows.sort(key=lambda row: -row.mean)
    named = [(row.method, _dot(row, row.mean, *row.interval)) for row in rows]
    told = {"test": "test", "train": "training"}[block]
    axis = _axis([dot for _, dot in named], f"mean return on the {told} tasks, 95 % interval")
    charts = [_bars("", named, axis)] if rows else []
    return Sheet(f"{data}: unseen tasks, by what was read of them", charts, _legend(rows))


def each_task_sheet(data: str, cells: Sequence[CellResult], block: Block = "test") -> Sheet:
    """A chart of every task, or one of all of many: the best of each kind of reading."""
    rows = best_of_each(summarise(cells, block))
    of_task = {
        task: [(row.method, _dot(row, *known[row.method])) for row in rows if row.method in known]
        for task, known in task_intervals(cells, block).items()
    }
    title = f"{data}: every unseen task, of each kind of reading the best"
    of_task = {task: named for task, named in of_task.items() if named}
    if len(of_task) > MANY_TASKS:
        return Sheet(title, [_a_row_each(of_task)], _legend(rows))
    axis = _axis([dot for named in of_task.values() for _, dot in named], "return, 95 % interval")
    charts = [_bars(task, named, axis) for task, named in of_task.items()]
    return Sheet(title, charts, _legend(rows))


def _a_row_each(of_task: Mapping[str, Sequence[tuple[str, Dot]]]) -> Chart:
    """Dots alone: intervals of so many would hide each other. Where the best is worst is last."""
    dots = {task: [replace(dot, low=math.nan, high=math.nan) for _, dot in named]
            for task, named in of_task.items()}  # fmt: skip
    order = sorted(dots, key=lambda task: -max(_policies(dots[task]), default=0.0))
    axis = axis_over([0.0, *(dot.value for row in dots.values() for dot in row
                             if math.isfinite(dot.value))], "return")  # fmt: skip
    drawn = row_chart("", [(task, dots[task]) for task in order], axis)
    return replace(drawn, width=WIDE, letters=LETTERS)


def _policies(dots: Iterable[Dot]) -> list[float]:
    return [dot.value for dot in dots if dot.key != REFERENCE and math.isfinite(dot.value)]


def _axis(dots: Iterable[Dot], label: str) -> Axis:
    return axis_over([0.0, *(e for dot in dots for e in (dot.value, dot.low, dot.high))], label)


def _bars(title: str, rows: Sequence[tuple[str, Dot]], axis: Axis) -> Chart:
    drawn = row_chart(title, [(name, [dot]) for name, dot in rows], axis, bars=True)
    return replace(drawn, width=WIDE, letters=LETTERS)


def _dot(row: Row, middle: float, low: float, high: float) -> Dot:
    return Dot(_key(row), middle, low, high)


def _key(row: Row) -> str:
    return REFERENCE if row.method in REFERENCES else COLOURS.get(row.reads, OWN)


def _legend(rows: Iterable[Row]) -> list[tuple[str, str]]:
    told = {_key(row): row.reads for row in rows}
    known = [(key, name) for name, key in COLOURS.items() if key in told]
    known += [(OWN, "policies, each task behind its own prompt")] * (OWN in told)
    return known + [(REFERENCE, "references")] * (REFERENCE in told)


def _trials(data: str, cells: Sequence[CellResult]) -> Sheet:
    """Random and expert as flat lines; no line where only one count was judged."""
    rows = summarise(cells, "test")
    found: dict[str, list[tuple[int, Row]]] = {}
    for row in rows:
        name, count = split_own(row.method)
        if count:
            found.setdefault(f"{name} own episodes", []).append((count, row))
    lines = {name: sorted(own, key=lambda one: one[0]) for name, own in found.items()}
    lines = {name: own for name, own in lines.items() if len(own) > 1}
    keys = {name: f"c{place}" for place, name in enumerate(lines)}
    flat = [row for row in rows if row.method in ("random", "expert")]
    charts = [
        _over_count(title, number, lines, keys, flat)
        for title, number in (("mean return", _mean), ("success", _success))
        if lines and all(number(row) is not None for own in lines.values() for _, row in own)
    ]  # fmt: skip
    legend = [*((key, name) for name, key in keys.items()), (REFERENCE, "random and expert")]
    return Sheet(f"{data}: unseen tasks after own episodes", charts, legend, columns=2)


def _mean(row: Row) -> float | None:
    return row.mean


def _success(row: Row) -> float | None:
    return row.success


def _over_count(
    title: str, number: Callable[[Row], float | None], lines: dict[str, list[tuple[int, Row]]],
    keys: dict[str, str], flat: Sequence[Row],
) -> Chart:  # fmt: skip
    counts = [count for own in lines.values() for count, _ in own]
    ends = (min(counts), max(counts))
    marks = [line(REFERENCE, ends, [number(row) or 0.0] * 2, row.method) for row in flat]
    for name, own in lines.items():
        at = [count for count, _ in own]
        heights = [number(row) or 0.0 for _, row in own]
        marks.append(line(keys[name], at, heights, name))
    values = [y for mark in marks for y in mark.points[:, 1].tolist()]
    return Chart(title, axis_over([0.0, *ends], "own episodes on each task"),
                 axis_over([0.0, *values], title), tuple(marks))  # fmt: skip


def _training(data: str, cells: Sequence[CellResult]) -> Sheet:
    return curves_sheet(f"{data}: action loss over updates", cells, "student")


def _adaptation(data: str, cells: Sequence[CellResult]) -> Sheet:
    return curves_sheet(f"{data}: alignment loss over updates", cells, "adapt")


def curves_sheet(title: str, cells: Sequence[CellResult], phase: str) -> Sheet:
    """One chart per label, all with the same axis of losses."""
    found: dict[str, list[Points]] = {}
    for cell in cells:
        for name, points in cell.content.get("curve", {}).items():
            if name.startswith(phase) and points:
                found.setdefault(" ".join([cell.label, *name.split()[1:]]), []).append(points)
    losses = [loss for seeds in found.values() for points in seeds for _, loss in points]
    y = axis_over(losses, "loss", is_log=True)
    charts = [_curve(label, seeds, y) for label, seeds in found.items()]
    return Sheet(title, charts, columns=3)


def _curve(label: str, seeds: Sequence[Points], y: Axis) -> Chart:
    marks: list[Mark] = []
    at: dict[float, list[float]] = {}
    for points in seeds:
        marks.append(line("thin", [step for step, _ in points], [loss for _, loss in points]))
        for step, loss in points:
            at.setdefault(step, []).append(loss)
    steps = sorted(at)
    marks.append(line("c0", steps, [float(np.mean(at[step])) for step in steps]))
    return Chart(label, axis_over([0.0, *steps], "updates"), y, tuple(marks))


_PICTURES: dict[str, Callable[[str, Sequence[CellResult]], Sheet]] = {
    "tasks": tasks_sheet, "each-task": each_task_sheet, "trials": _trials, "training": _training,
    "adaptation": _adaptation,
}  # fmt: skip
