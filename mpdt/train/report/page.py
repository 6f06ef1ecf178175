"""Result page: the tables and pictures of a run or a study on one HTML page, without network.

    mpdt-train report runs/ml10-base --html ml10.html

Tables are those of the terminal (`evaluate/tables.py`, `study/summary.py`); what the reference
policies earn stands beside every method, in grey.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mpdt.draw.chart import Chart
from mpdt.draw.html import picture, render, write_page
from mpdt.draw.table import Table
from mpdt.errors import MpdtError
from mpdt.train.evaluate.score import MEAN, Block, Score
from mpdt.train.evaluate.tables import BLOCKS, build_tables
from mpdt.train.fit.log import MetricsLog
from mpdt.train.fit.validation import PHASE as VALIDATION
from mpdt.train.report.charts import (
    Curves,
    adaptation_chart,
    bars,
    colours,
    legend,
    loss_curves,
)
from mpdt.train.report.pictures import curves_sheet, each_task_sheet, tasks_sheet
from mpdt.train.report.study_tables import report_tables
from mpdt.train.run.results import scores_in, trained_as
from mpdt.train.study.cells import CellResult
from mpdt.train.study.maps import map_pixels, prompt_maps
from mpdt.version import __version__


@dataclass(frozen=True)
class Part:
    """One block of tasks of one data set: charts beside each other, tables, notes.

    Args:
        legend: (key, method) of everything drawn.
        tasks: one chart per task, folded away where there are many.
        is_wide: its charts are as wide as the page, one below the other.
    """

    title: str
    tables: Sequence[Table]
    legend: Sequence[tuple[str, str]] = ()
    means: Sequence[Chart] = ()
    tasks: Sequence[Chart] = ()
    is_wide: bool = False


@dataclass(frozen=True)
class Content:
    """Everything on the page."""

    title: str
    facts: Sequence[tuple[str, str]]
    parts: Sequence[Part]
    curves: Sequence[Curves] = ()
    maps: Sequence[tuple[str, str]] = ()
    """Name and picture of each prompt."""
    inferred: Sequence[tuple[str, str]] = ()
    """Task and the training tasks that were found to explain it."""
    settings: str = ""
    warnings: Sequence[str] = field(default_factory=tuple)


def write_result(target: Path, content: Content) -> None:
    """Raises: StorageError where the disk refuses."""
    text = render("result.html", "mpdt.train.report", content=content, version=__version__)
    write_page(target, text)


# ---- one run ----


def run_content(results: Mapping[str, Any], folder: Path) -> Content:
    """The page of results.json, with the curves and prompts that lie beside it, if they do.

    Weights that cannot be read are told of on the page.
    """
    scores = scores_in(results)
    tables = iter(build_tables(scores))
    parts = []
    for block, _ in BLOCKS:
        own = [score for score in scores if score.block == block]
        if own:
            pair = (next(tables), next(tables))
            parts.append(_part(own, pair))
    log = MetricsLog(folder / "metrics.jsonl").records()
    maps, warnings = _maps(folder / "weights.safetensors", results)
    return Content(
        title=str(results.get("name", folder.name)), facts=list(_facts(results)), parts=parts,
        curves=_run_curves(log), maps=maps,
        inferred=[(r["task"], _weights(r["weights"])) for r in log if r["phase"] == "infer"],
        settings=json.dumps(results.get("config", {}), indent=1),
        warnings=[*_incomplete(results), *warnings],
    )  # fmt: skip


def _maps(
    weights: Path, results: Mapping[str, Any]
) -> tuple[list[tuple[str, str]], list[str]]:  # fmt: skip
    """Pictures of the prompts, and why there are none."""
    try:
        maps = prompt_maps(weights, trained_as(results)) if weights.exists() else {}
    except MpdtError as error:
        return [], [f"No maps of the prompts: {error.message()}"]
    return [(name, picture(map_pixels(one), lossless=True)) for name, one in maps.items()], []


def _incomplete(results: Mapping[str, Any]) -> list[str]:
    if results.get("complete") is not False:
        return []
    asked = results.get("updates_asked", {})
    done = [f"{phase} {n} of {asked.get(phase)}" for phase, n in results.get("updates", {}).items()]
    return [f"Incomplete, ended by a time limit after updates: {', '.join(done)}."]


def _part(scores: Sequence[Score], tables: tuple[Table, Table]) -> Part:
    keys = colours(score.method for score in scores)
    tasks = dict.fromkeys(score.task for score in scores if score.task != MEAN)
    overall, means = tables
    return Part(
        title=means.title.partition(": mean over")[0], tables=(means, overall), legend=legend(keys),
        means=bars("mean over tasks", [score for score in scores if score.task == MEAN], keys),
        tasks=[
            chart for task in tasks
            for chart in bars(task, [score for score in scores if score.task == task], keys)
        ],
    )  # fmt: skip


def _facts(results: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    data, config = results.get("data", {}), results.get("config", {})
    part = f":{data['slice']}" if data.get("slice") else ""
    yield "data", f"{data.get('name')} {data.get('version')}{part}, {data.get('quality')}"
    yield "content", str(data.get("content_hash", ""))[:12]
    for key in ("method", "seed"):
        if key in config:
            yield key, str(config[key])
    backbone = results.get("backbone", {})
    if backbone:
        yield "language model", f"{backbone.get('name')}, {backbone.get('num_layers')} layers"
    if "num_trainables" in results:
        yield "trained numbers", f"{results['num_trainables']:,}"
    for phase, updates in results.get("updates", {}).items():
        yield f"{phase} updates", f"{updates:,}"


def _run_curves(log: Sequence[Mapping[str, Any]]) -> list[Curves]:
    losses: dict[str, list[tuple[float, float]]] = {}
    starts: dict[str, list[tuple[float, list[float]]]] = {}
    for record in log:
        if "action_loss" in record:
            losses.setdefault(record["phase"], []).append((record["step"], record["action_loss"]))
        elif record.get("phase") == VALIDATION:
            points = losses.setdefault(VALIDATION, [])
            points.append((record["step"], record["action_error"]))
        elif record.get("phase") == "adapt":
            starts.setdefault(record["start"], []).append((record["step"], record["losses"]))
    found = []
    if losses:
        found.append(
            loss_curves("Learning", "Action loss over updates of each phase.", list(losses.items()))
        )
    if starts:
        charts = [adaptation_chart(start, points) for start, points in starts.items()]
        told = "Alignment loss over updates: one line per test task, their mean in colour."
        found.append(Curves("Adaptation", told, charts))
    return found


def _weights(weights: Mapping[str, float] | Sequence[Any]) -> str:
    if not isinstance(weights, Mapping):
        return str(weights)
    ordered = sorted(weights.items(), key=lambda item: -item[1])
    return ", ".join(f"{task} {weight:.2f}" for task, weight in ordered[:5] if weight > 0.005)


# ---- a study ----


def study_content(cells: Sequence[CellResult], name: str, studies: Sequence[str] = ()) -> Content:
    """The page of the cells of studies (default: of the one of that name): one part per data set
    and block."""
    tables = report_tables(cells, studies or [name])
    verdicts = [table for table in tables if ":" not in table.title]
    parts = [Part(table.title, [table]) for table in verdicts]
    curves = []
    for data in dict.fromkeys(cell.data for cell in cells):
        own = [cell for cell in cells if cell.data == data]
        for block, words in (("test", "test tasks"), ("train", "training tasks")):
            chosen = [table for table in tables if table.title == f"{data}: {words}"]
            if chosen:
                parts.append(_study_part(own, block, chosen))  # type: ignore[arg-type]
        for phase, words in (("student", "Learning"), ("adapt", "Adaptation")):
            sheet = curves_sheet("", own, phase)
            told = "Action loss" if phase == "student" else "Alignment loss"
            told += " over updates: a thin line for each seed, their mean in colour."
            curves += [Curves(f"{words}, {data}", told, sheet.charts)] * bool(sheet.charts)
    facts = [("cells", str(len(cells))), ("seeds", f"up to {len({cell.seed for cell in cells})}")]
    return Content(title=name, facts=facts, parts=parts, curves=curves)


def _study_part(cells: Sequence[CellResult], block: Block, tables: Sequence[Table]) -> Part:
    """As the pictures of a study: coloured by what was read, names written out."""
    data = cells[0].data
    means, tasks = tasks_sheet(data, cells, block), each_task_sheet(data, cells, block)
    return Part(tables[0].title, tables, means.legend, means.charts, tasks.charts, is_wide=True)
