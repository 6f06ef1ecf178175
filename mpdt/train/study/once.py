"""Once: a row that reads nothing of an unseen task is the same policy in every cell that judged it.

    cells   ones-long s0 s1 s2    few-shot-all s0 s1 s2     three sets of weights, judged twice
    rows    ones-long P_c o mean P_k, not adapted           one row of three runs, under the name
                                                            that comes first in the studies

Weights are the same where the training part of two identities is. Rows that read something of the
task differ in how they were adapted, and stay.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import msgspec

from mpdt.train.evaluate.score import Score
from mpdt.train.study.cells import CellResult
from mpdt.train.study.plans import STUDIES

NOTHING: tuple[str, ...] = ("nothing", "task id")
Weights = tuple[str, str, str]
"""Data, hash of the training, and what a row's name says beside its label."""


def pooled(method: str) -> str:
    """Rows that differ in the seed of their trials alone are runs of one method.

    ones-alone-t1 10 own episodes -> ones-alone 10 own episodes
    """
    return re.sub(r"^(\S+)-t\d+(?= |$)", r"\1", method)


def place_in_studies(data: str, label: str) -> int:
    """Where a label first stands in the studies; behind all of them where it is in none."""
    cells = [cell for study in STUDIES.values() for cell in study]
    found = (number for number, cell in enumerate(cells)
             if (cell.data, pooled(cell.label or cell.method)) == (data, label))  # fmt: skip
    return next(found, len(cells))


@dataclass(frozen=True)
class _Judged:
    """One row of one cell that reads nothing."""

    cell: int
    method: str
    label: str
    weights: Weights


def told_once(cells: Sequence[CellResult]) -> list[CellResult]:
    """The cells with every set of weights once among the rows that read nothing.

    Labels that share weights become one row: named as the one with most of them, among equals as
    the first of the studies, whose own numbers count where it has them.
    """
    judged = list(_judged(cells))
    names = _names(judged)
    kept: dict[Weights, _Judged] = {}
    for one in sorted(judged, key=lambda one: one.label != names[one.weights]):
        kept.setdefault(one.weights, one)
    new: dict[tuple[int, str], str | None] = {(one.cell, one.method): None for one in judged}
    for weights, one in kept.items():
        is_own = one.label == names[weights]
        new[one.cell, one.method] = one.method if is_own else names[weights] + weights[2]
    return [
        replace(cell, scores=tuple(_told(cell.scores, number, new)))
        for number, cell in enumerate(cells)
    ]


def _told(
    scores: Sequence[Score], cell: int, new: dict[tuple[int, str], str | None]
) -> Iterator[Score]:
    for score in scores:
        name = new.get((cell, score.method), score.method) if _reads_nothing(score) else ""
        if name is not None:
            yield msgspec.structs.replace(score, method=name) if name else score


def _reads_nothing(score: Score) -> bool:
    return score.block == "test" and score.reads in NOTHING


def _judged(cells: Sequence[CellResult]) -> Iterator[_Judged]:
    for number, cell in enumerate(cells):
        training = dict(cell.content.get("identity") or {}).get("training")
        for method in dict.fromkeys(one.method for one in cell.scores if _reads_nothing(one)):
            if training and method.startswith(cell.label):
                weights = (cell.data, str(training), method.removeprefix(cell.label))
                yield _Judged(number, method, pooled(cell.label), weights)


def _names(judged: Sequence[_Judged]) -> dict[Weights, str]:
    """The label that each set of weights stands under."""
    rows: dict[tuple[str, str, str], set[Weights]] = {}
    for one in judged:
        data, _, rest = one.weights
        rows.setdefault((data, rest, one.label), set()).add(one.weights)

    def place(row: tuple[str, str, str]) -> tuple[int, int]:
        return -len(rows[row]), place_in_studies(row[0], row[2])

    names: dict[Weights, str] = {}
    for row in sorted(rows, key=place):
        shared = [names[weights] for weights in rows[row] if weights in names]
        label = min(shared) if shared else row[2]
        names.update((weights, label) for weights in rows[row] if weights not in names)
    return names
