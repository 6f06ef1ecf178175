"""Results of a study -> tables: one row per method, all its seeds together.

    results/STUDY/CELL.json  ──>  per data set: what each method earns on the test tasks,
                                  what it read of them, and how well the training tasks go

Intervals of a mean return: with several training seeds Student's t over them; with one seed its
evaluation episodes are resampled, which says nothing about other seeds. Runs that share a training
seed (seeds of trials) are not independent: they are averaged first and count as one. Of an IQM: the
stratified bootstrap of its authors, too narrow for a few seeds (`aggregate.py`).
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mpdt.draw.table import Table
from mpdt.reading import refuse_closed
from mpdt.train.evaluate.aggregate import iqm, seed_interval, seed_means, stratified_interval
from mpdt.train.evaluate.score import MEAN, REFERENCES, Block, Score
from mpdt.train.study.cells import CellResult, read_cell_files
from mpdt.train.study.once import pooled, told_once
from mpdt.train.study.plans import STUDIES

Runs = list[tuple[int, list[Score]]]
"""Training seed and scores of every run of one method."""


@dataclass(frozen=True)
class Row:
    """One method on one block of tasks, over R training seeds; nan where nothing is known."""

    method: str
    reads: str
    num_seeds: int
    mean: float
    interval: tuple[float, float]
    levels: NDArray[np.float64] = field(compare=False)
    """(R, N) normalised returns."""
    success: float | None
    own_steps: float | None = None
    """Steps of own episodes per task; None where none were read."""
    num_runs: int = 1
    """More than the seeds where runs of one seed differ in the seed of their trials."""
    dtype: str = "-"
    """Numbers that a method was trained in; "both" where its runs differ."""

    @property
    def normalised(self) -> float:
        return float(self.levels.mean())

    @property
    def iqm(self) -> float:
        """Of the normalised returns of all tasks and seeds."""
        return iqm(self.levels)

    @property
    def iqm_interval(self) -> tuple[float, float]:
        """It takes longer than all else of a row, so it is computed where it is shown."""
        if len(self.levels) < 2:
            return (math.nan, math.nan)
        return stratified_interval(self.levels, iqm)

    @property
    def seeds(self) -> str:
        return told_seeds(self.num_seeds, self.num_runs)


def told_seeds(seeds: int, runs: int) -> str:
    """3 seeds of 9 runs  ->  3 (9 runs)"""
    return f"{seeds} ({runs} runs)" if runs > seeds else str(seeds)


def is_study(folder: Path) -> bool:
    """Whether results of cells lie there or in folders below, and not those of one run."""
    return not (folder / "results.json").exists() and bool(studies_in(folder))


def studies_in(folder: Path) -> list[Path]:
    """The folders of cells: this one, or those right below it that are no runs.

    Raises: StorageError for a folder that the system will not list.
    """
    if any(folder.glob("*.json")):
        return [] if (folder / "config.json").exists() else [folder]
    for place in (folder, *folder.glob("*/")):
        refuse_closed(place)
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
    dtypes: dict[str, set[str]] = {}
    for cell in told_once(cells):
        own: dict[str, list[Score]] = {}
        for score in cell.scores:
            if score.block == block:
                own.setdefault(pooled(score.method), []).append(score)
        for method, scores in own.items():
            runs = by_method.setdefault(method, [])
            if method not in REFERENCES or not runs:
                runs.append((cell.seed, scores))
                dtypes.setdefault(method, set()).add(_dtype(cell))
    first = [method for method in REFERENCES if method in by_method]
    ordered = [*first, *(method for method in by_method if method not in first)]
    return [_row(by_method[method], method, dtypes[method]) for method in ordered]


def _dtype(cell: CellResult) -> str:
    found: str = dict(cell.content.get("backbone") or {}).get("dtype", "-")
    return found


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
                methods.setdefault(pooled(score.method), []).append((cell.seed, [score]))
    return {
        task: {method: _interval_of(method, scores) for method, scores in methods.items()}
        for task, methods in found.items()
    }


def _interval_of(method: str, runs: Runs) -> tuple[float, float, float]:
    """Mean return on one task, and its interval."""
    if method in REFERENCES:
        runs = runs[:1]
    scores = [score for _, own in runs for score in own]
    means = _by_seed(runs, [scores[0].task], "mean")
    return (float(means.mean()), *_interval(means, scores))


def _interval(means: NDArray[np.float64], scores: Sequence[Score]) -> tuple[float, float]:
    """Over the R seeds of means (R, N); of one seed over the episodes of its runs.

    That is unknown where every task has one episode, which resampling cannot move; of several
    runs it is the mean of their ends, since they may err together.
    """
    if len(means) > 1:
        return seed_interval(means)
    low, high = (float(np.mean([getattr(one, end) for one in scores])) for end in ("low", "high"))
    return (low, high) if low < high else (math.nan, math.nan)


def _row(runs: Runs, method: str, dtypes: Set[str]) -> Row:
    tasks = [score.task for score in runs[0][1] if score.task != MEAN]
    means, levels = (_by_seed(runs, tasks, name) for name in ("mean", "normalised"))
    overall = [score for _, scores in runs for score in scores if score.task == MEAN]
    shares = [(seed, score.success) for seed, scores in runs for score in scores
              if score.task == MEAN and score.success is not None]  # fmt: skip
    return Row(
        method=method, reads=overall[0].reads or "-", num_seeds=len(means),
        mean=float(means.mean()), interval=_interval(means, overall), levels=levels,
        success=float(seed_means(shares).mean()) if shares else None,
        own_steps=overall[0].own_steps, num_runs=len(runs),
        dtype="both" if len(dtypes) > 1 else min(dtypes),
    )  # fmt: skip


def _by_seed(runs: Runs, tasks: Sequence[str], name: str) -> NDArray[np.float64]:
    """(R, N) of one number of the scores."""
    found = [(seed, {one.task: float(getattr(one, name)) for one in own}) for seed, own in runs]
    return seed_means((seed, [of_task[task] for task in tasks]) for seed, of_task in found)


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
        line = [row.method, _number(row.mean, 1), _ends(row.interval, 1),
                _number(row.iqm, 2), _ends(row.iqm_interval, 2)]  # fmt: skip
        if has_success:
            line.append("-" if row.success is None else f"{row.success:.0%}")
        line += [row.reads] if told else []
        if tried:
            line.append("-" if row.own_steps is None else f"{row.own_steps:,.0f}")
        known = row.method in REFERENCES
        cells.append((*line, *(("-", "-") if known else (row.dtype, row.seeds))))
    return Table(title, (*columns, "numbers", "seeds"), tuple(cells), notes)


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def _ends(ends: tuple[float, float], digits: int) -> str:
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
