"""Run the cells of a study one after another; what is done is skipped, what failed is told.

`apart.py` runs several at a time, each by `run_study` of that cell alone.

runs/STUDY/CELL/            the run, resumable like any other
results/STUDY/CELL.json     its results, small: a run counts as done when this is here and
                            of the same settings and data
results/STUDY/CELL.prompts.safetensors    P_c and some P_k, to be drawn: one cell per data set
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mpdt.disk import disk, holding, write_bytes
from mpdt.errors import BusyError, FormatError, MissingFileError, MpdtError, StorageError
from mpdt.reading import read_json
from mpdt.train.evaluate.sealed import check_digest, sealed
from mpdt.train.fit.validation import PHASE as VALIDATION
from mpdt.train.run.config import TrainConfig, from_plain, to_plain
from mpdt.train.run.folder import locate
from mpdt.train.run.identity import plain_settings
from mpdt.train.run.methods import apply_method, merge
from mpdt.train.run.older import called_once
from mpdt.train.run.pipeline import run_pipeline
from mpdt.train.run.prepare import Prepared, prepare
from mpdt.train.run.presets import get_preset
from mpdt.train.run.progress import Progress
from mpdt.train.study.maps import KEPT, keep_prompts
from mpdt.train.study.recipes import Cell

State = Literal["done", "to do", "no data", "busy", "failed"]
CURVE_POINTS = 40


@dataclass(frozen=True)
class Outcome:
    """What became of one cell; `note` says why it is not done."""

    cell: Cell
    state: State
    note: str = ""


@dataclass(frozen=True)
class Places:
    """Folders of a study: data files, runs, results."""

    data: Path
    runs: Path
    results: Path

    def file(self, cell: Cell) -> Path:
        return self.data / f"{cell.data}.h5"

    def result(self, cell: Cell) -> Path:
        return self.results / f"{cell.name}.json"

    def prompts(self, cell: Cell) -> Path:
        return self.results / f"{cell.name}{KEPT}"

    def may_keep_prompts(self, cell: Cell) -> bool:
        """Whether no other cell of that data set has kept its own; one is drawn."""
        kept = {path.name for path in self.results.glob(f"{cell.data}.*{KEPT}")}
        return kept <= {self.prompts(cell).name}


def configure(cell: Cell) -> TrainConfig:
    """Preset, then method, then the cell's own changes. Raises: UsageError, SpecError."""
    plain = to_plain(apply_method(get_preset(cell.preset), cell.method))
    label = {"method": cell.label} if cell.label else {}
    return from_plain(called_once(merge(plain, {**cell.changes, **label, "seed": cell.seed})))


def inspect_cell(cell: Cell, places: Places, restart: bool = False) -> Outcome:
    """Whether the cell is done; reads the file's header, trains nothing.

    A file or setting that is refused makes it `failed`.

    Args:
        restart: a cell that is done is to do again.
    """
    return _look_at(cell, places, restart)[0]


def _look_at(cell: Cell, places: Places, restart: bool) -> tuple[Outcome, Prepared | None]:
    """The outcome, and what a run of the cell would begin with, where there is something."""
    outcome, prepared = _as_it_is(cell, places)
    if restart and outcome.state == "done":
        again = Outcome(cell, "to do") if prepared else Outcome(cell, "no data",
                                                                str(places.file(cell)))  # fmt: skip
        return again, prepared
    return outcome, prepared


def _as_it_is(cell: Cell, places: Places) -> tuple[Outcome, Prepared | None]:
    stored, damage = _read(places.result(cell))
    try:
        config = configure(cell)
        try:
            prepared = prepare(config, str(places.file(cell)))
        except MissingFileError:
            if stored is not None and stored.get("config_hash") == config_hash(
                plain_settings(config)
            ):
                return Outcome(cell, "done", "data file not here: content not compared"), None
            return Outcome(cell, "no data", str(places.file(cell))), None
    except MpdtError as error:
        return Outcome(cell, "failed", error.message()), None
    if stored is not None and stored.get("identity") == prepared.identity.hashes:
        return Outcome(cell, "done"), prepared
    note = damage or ("" if stored is None else "its result is of other settings or data")
    return Outcome(cell, "to do", note), prepared


def run_study(
    cells: Sequence[Cell], places: Places, progress: Progress, restart: bool = False
) -> Iterator[Outcome]:
    """Each cell's outcome as it comes. Raises: Stopped after a signal; the next call goes on.

    Args:
        restart: begin every cell anew, the done ones too.
    """
    for cell in cells:
        outcome, prepared = _look_at(cell, places, restart)
        if prepared is not None and outcome.state == "to do":
            progress.say(f"{cell.name} {outcome.note}".rstrip())
            try:
                _run_cell(cell, prepared, places, progress, restart)
                outcome = Outcome(cell, "done")
            except BusyError as error:  # another process has what it writes
                outcome = Outcome(cell, "busy", error.message())
            except MpdtError as error:
                progress.say(error.render())
                outcome = Outcome(cell, "failed", error.message())
        yield outcome


def _run_cell(
    cell: Cell, prepared: Prepared, places: Places, progress: Progress, restart: bool
) -> None:
    folder = locate(places.runs, cell.name)
    results = run_pipeline(prepared, folder, progress, "restart" if restart else "continue")
    log = folder.log.records()
    extra = {
        "cell": cell.name,
        "config_hash": config_hash(prepared.plain),
        "curve": _curve(log),
        "inferred": {r["task"]: r["weights"] for r in log if r.get("phase") == "infer"},
    }
    with disk(places.results):
        places.results.mkdir(parents=True, exist_ok=True)
    # Another cell of that data set may end now as well.
    with holding(places.results / f"{cell.data}{KEPT}", wait_s=60):
        if places.may_keep_prompts(cell):
            keep_prompts(folder.weights, places.prompts(cell))
    write_bytes(places.result(cell), encode_cell(results | extra))


def config_hash(plain: Mapping[str, Any]) -> str:
    """SHA-256 over what counts of the settings; whatever it was put together from."""
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def encode_cell(content: Mapping[str, Any]) -> bytes:
    """JSON with one line per key and one per score: small, and readable as a diff; its digest."""
    content = sealed(content)
    lines = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in content.items()
             if key != "scores"]  # fmt: skip
    scores = ",\n".join(json.dumps(score) for score in content["scores"])
    return ("{\n" + ",\n".join(lines) + f',\n"scores": [\n{scores}\n]\n}}\n').encode()


def _curve(log: Sequence[Mapping[str, Any]]) -> dict[str, list[list[float]]]:
    """At most `CURVE_POINTS` pairs of (update, loss) per phase, the last one among them.

    `teacher`, `student`: action loss. `validation`: action error. `adapt START`: alignment, mean
    over the test tasks.
    """
    curves: dict[str, list[list[float]]] = {}
    for record in log:
        if "action_loss" in record:
            phase, loss = record["phase"], record["action_loss"]
        elif record.get("phase") == VALIDATION:
            phase, loss = VALIDATION, record["action_error"]
        elif record.get("phase") == "adapt":
            phase, loss = f"adapt {record['start']}", float(np.mean(record["losses"]))
        else:
            continue
        curves.setdefault(phase, []).append([record["step"], round(loss, 6)])
    every = {phase: -(-len(points) // CURVE_POINTS) for phase, points in curves.items()}
    return {phase: points[::-1][:: every[phase]][::-1] for phase, points in curves.items()}


def _read(path: Path) -> tuple[dict[str, Any] | None, str]:
    """The result of a cell, if there is one; and what is wrong with it otherwise."""
    try:
        stored = read_json(path)
        check_digest(stored, str(path), "")
    except MissingFileError:
        return None, ""
    except (FormatError, StorageError) as error:
        return None, f"its result is damaged: {error.what}"
    return stored, ""
