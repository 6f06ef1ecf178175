"""Results of a study -> tables: one row per method, all its seeds together.

    results/STUDY/CELL.json  ──>  per data set: what each method earns on the test tasks,
                                  what it read of them, and how well the training tasks go

Intervals of a mean return: with several training seeds Student's t over them; with one seed its
evaluation episodes are resampled, which says nothing about other seeds. Runs that share a training
seed (seeds of trials) share its weights: they are averaged first and count as one. Of an IQM: the
stratified bootstrap of its authors, too narrow for a few seeds (`aggregate.py`).
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mpdt.draw.table import Table
from mpdt.train.evaluate.aggregate import iqm, seed_interval, stratified_interval
from mpdt.train.evaluate.score import MEAN, REFERENCES, Block, Score
from mpdt.train.study.cells import CellResult, read_cell_files
from mpdt.train.study.once import pooled, told_once
from mpdt.train.study.plans import STUDIES

Runs = dict[int, list[list[Score]]]
"""The scores of every run of one method, by training seed."""


@dataclass(frozen=True)
class Row:
    """One method on one block of tasks, over R training seeds; nan where nothing is known."""

    method: str
    reads: str
    num_seeds: int
    mean: float
    interval: tuple[float, float]
    iqm: float
    """Of the normalised returns of all tasks and seeds."""
    iqm_interval: tuple[float, float]
    success: float | None
    own_steps: float | None = None
    """Steps of own episodes per task; None where none were read."""
    num_runs: int | None = None
    """Where it differs from the seeds: runs of one seed differ in the seed of their trials."""

    @property
    def seeds(self) -> str:
        return f"{self.num_seeds} ({self.num_runs} runs)" if self.num_runs else str(self.num_seeds)


def is_study(folder: Path) -> bool:
    """Whether results of cells lie there or in folders below, and not those of one run."""
    return not (folder / "results.json").exists() and bool(studies_in(folder))


def studies_in(folder: Path) -> list[Path]:
    """The folders of cells: this one, or those right below it that are no runs."""
    if any(folder.glob("*.json")):
        return [folder]
    below = sorted({path.parent for path in folder.glob("*/*.json")})
    return [one for one in below if not (one / "config.json").exists()]


def read_cells(folder: Path) -> list[CellResult]:
    """All cells of a folder, by study and name. Raises: FormatError, as `read_cell_files`."""
    paths = [path for study in studies_in(folder) for path in sorted(study.glob("*.json"))]
    return [
        CellResult(file.data.name, file.config.method, file.config.seed, file.scores, content)
        for file, content in read_cell_files(paths)
    ]


def summarise(cells: Sequence[CellResult], block: Block) -> list[Row]:
    """Rows of one data set: references once, then the methods in the order of the cells."""
    by_method: dict[str, Runs] = {}
    for cell in told_once(cells):
        own: dict[str, list[Score]] = {}
        for score in cell.scores:
            if score.block == block:
                own.setdefault(pooled(score.method), []).append(score)
        for method, scores in own.items():
            runs = by_method.setdefault(method, {})
            if method not in REFERENCES or not runs:
                runs.setdefault(cell.seed, []).append(scores)
    first = [method for method in REFERENCES if method in by_method]
    return [_row(by_method[m], m) for m in [*first, *(m for m in by_method if m not in first)]]


def unseen_rows(cells: Sequence[CellResult], data: str) -> dict[str, Row]:
    """Rows of a data set's unseen tasks by name."""
    return {row.method: row for row in summarise([c for c in cells if c.data == data], "test")}


def best_of_each(rows: Sequence[Row]) -> list[Row]:
    """The references, then of each kind of reading the method that earns most."""
    best: dict[str, Row] = {}
    for row in rows:
        known = best.get(row.reads)
        if row.method not in REFERENCES and (known is None or row.mean > known.mean):
            best[row.reads] = row
    return [row for row in rows if row.method in REFERENCES] + list(best.values())


def task_intervals(
    cells: Sequence[CellResult], block: Block
) -> dict[str, dict[str, tuple[float, float, float]]]:
    """task -> method -> mean return and its interval, over seeds as in `summarise`."""
    found: dict[str, dict[str, Runs]] = {}
    for cell in told_once(cells):
        for score in cell.scores:
            if score.block == block and score.task != MEAN:
                methods = found.setdefault(score.task, {})
                runs = methods.setdefault(pooled(score.method), {})
                runs.setdefault(cell.seed, []).append([score])
    return {
        task: {method: _interval_of(method, scores) for method, scores in methods.items()}
        for task, methods in found.items()
    }


def _interval_of(method: str, runs: Runs) -> tuple[float, float, float]:
    ((first, *_), *_) = next(iter(runs.values()))
    if method in REFERENCES:
        return (first.mean, *_of_episodes([first]))
    means = _matrix(runs, [first.task], "mean")
    if len(means) == 1:
        own = [score for scores in runs.values() for (score,) in scores]
        return (float(means.mean()), *_of_episodes(own))
    return (float(means.mean()), *seed_interval(means))


def _of_episodes(runs: Sequence[Score]) -> tuple[float, float]:
    """Of one seed; unknown where every task has one episode, which resampling cannot move.

    Of several runs of that seed the mean of their ends: they may err together.
    """
    low, high = (float(np.mean([getattr(one, end) for one in runs])) for end in ("low", "high"))
    return (low, high) if low < high else (math.nan, math.nan)


def _row(runs: Runs, method: str) -> Row:
    every = [scores for own in runs.values() for scores in own]
    tasks = [score.task for score in every[0] if score.task != MEAN]
    means, levels = (_matrix(runs, tasks, name) for name in ("mean", "normalised"))
    overall = [score for scores in every for score in scores if score.task == MEAN]
    interval = _of_episodes(overall)
    level_interval = (math.nan, math.nan)
    if len(runs) > 1:
        interval = seed_interval(means)
        level_interval = stratified_interval(levels, iqm)
    shares = [score.success for score in overall if score.success is not None]
    return Row(
        method=method, reads=overall[0].reads or "-", num_seeds=len(runs),
        mean=float(means.mean()), interval=interval, iqm=iqm(levels),
        iqm_interval=level_interval, success=float(np.mean(shares)) if shares else None,
        own_steps=overall[0].own_steps, num_runs=len(every) if len(every) > len(runs) else None,
    )  # fmt: skip


def _matrix(runs: Runs, tasks: Sequence[str], name: str) -> NDArray[np.float64]:
    """(R, N) of one number of the scores: R training seeds, the runs of each averaged."""

    def of_run(scores: Sequence[Score]) -> list[float]:
        at = {score.task: float(getattr(score, name)) for score in scores}
        return [at[task] for task in tasks]

    return np.array([np.mean([of_run(scores) for scores in own], axis=0) for own in runs.values()])


def study_tables(cells: Sequence[CellResult], *studies: str) -> list[Table]:
    """Two tables per data set; cells of the studies without a result stand below as not run."""
    tables = []
    asked = [cell for study in studies for cell in STUDIES.get(study, ())]
    for data in dict.fromkeys(cell.data for cell in cells):
        own = [cell for cell in cells if cell.data == data]
        present = {f"{cell.data}.{cell.label}.s{cell.seed}" for cell in own}
        missing = [cell.name for cell in asked if cell.data == data and cell.name not in present]
        notes = (f"not run: {', '.join(missing)}",) if missing else ()
        for block, title in (("test", "test tasks"), ("train", "training tasks")):
            rows = summarise(own, block)  # type: ignore[arg-type]
            if rows:
                tables.append(_table(f"{data}: {title}", rows, block == "test", notes))
                notes = ()
    empty = {cell.data for cell in asked} - {cell.data for cell in cells}
    if empty and tables:
        last = tables[-1]
        note = f"no cell run: {', '.join(sorted(empty))}"
        tables[-1] = Table(last.title, last.columns, last.rows, (*last.notes, note))
    return tables


def _table(title: str, rows: Sequence[Row], told: bool, notes: tuple[str, ...]) -> Table:
    has_success = any(row.success is not None for row in rows)
    columns = ["method", "mean return", "95 % interval", "IQM normalised", "95 % interval "]
    columns += ["success"] if has_success else []
    columns += ["reads"] if told else []
    tried = told and any(row.own_steps is not None for row in rows)
    columns += ["own steps per task"] if tried else []
    cells = []
    for row in rows:
        line = [row.method, _number(row.mean, 1), _interval(row.interval, 1),
                _number(row.iqm, 2), _interval(row.iqm_interval, 2)]  # fmt: skip
        if has_success:
            line.append("-" if row.success is None else f"{row.success:.0%}")
        line += [row.reads] if told else []
        if tried:
            line.append("-" if row.own_steps is None else f"{row.own_steps:,.0f}")
        known = row.method in REFERENCES
        cells.append((*line, "-" if known else row.seeds))
    return Table(title, (*columns, "seeds"), tuple(cells), notes)


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def _interval(ends: tuple[float, float], digits: int) -> str:
    low, high = (_number(end, digits) for end in ends)
    return f"[{low}, {high}]" if math.isfinite(sum(ends)) else "-"


def cells_csv(cells: Sequence[CellResult]) -> str:
    """Every score of every cell, one line each."""
    stream = io.StringIO()
    fields = ["method", "block", "task", "mean", "low", "high", "normalised", "success", "reads"]
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["data", "cell", "seed", *fields])
    for cell in cells:
        for score in cell.scores:
            values = [getattr(score, field) for field in fields]
            rounded = [round(v, 4) if isinstance(v, float) else v for v in values]
            writer.writerow([cell.data, cell.label, cell.seed, *rounded])
    return stream.getvalue()
