"""Charts of results: a bar per method with its interval, losses over updates."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mpdt.draw.chart import Chart, Dot, Mark, axis_over, line, row_chart
from mpdt.train.evaluate.score import REFERENCES, Score

COLOURS = 10
REFERENCE = "reference"  # CSS key of what was not learnt: grey
Points = Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Curves:
    """Charts that share a legend."""

    title: str
    told: str
    charts: Sequence[Chart]
    legend: Sequence[tuple[str, str]] = ()


def colours(methods: Iterable[str]) -> dict[str, str]:
    """CSS key of each method."""
    names = list(dict.fromkeys(methods))
    own = [name for name in names if name not in REFERENCES]
    colour = {name: f"c{place % COLOURS}" for place, name in enumerate(own)}
    return {name: colour.get(name, REFERENCE) for name in names}


def legend(keys: Mapping[str, str]) -> list[tuple[str, str]]:
    """(key, method) of the methods with a colour of their own, and one for all references."""
    own = [(key, name) for name, key in keys.items() if key != REFERENCE]
    return own + [(REFERENCE, "references")] * (len(own) < len(keys))


def bars(title: str, scores: Sequence[Score], keys: Mapping[str, str]) -> list[Chart]:
    """Return of every method with its interval; nothing where none was measured."""
    names = short_names(keys)
    rows = [
        (names[score.method],
         [Dot(keys[score.method], score.mean, score.low, score.high, _told(score))])
        for score in scores if math.isfinite(score.mean)
    ]  # fmt: skip
    ends = [end for _, (dot,) in rows for end in (dot.value, dot.low, dot.high)]
    return [row_chart(title, rows, axis_over([0.0, *ends], "return"), bars=True)] if rows else []


def short_names(keys: Mapping[str, str]) -> dict[str, str]:
    """Methods without the words that all of them begin with: a row has room for a few.

    `MPDT infer`, `MPDT from cross, adapted` -> `infer`, `from cross, adapted`
    """
    own = {name: name.split(" ") for name, key in keys.items() if key != REFERENCE}
    columns = list(zip(*own.values(), strict=False)) if len(own) > 1 else []
    shared = next((i for i, words in enumerate(columns) if len(set(words)) > 1), 0)
    return {name: " ".join(own[name][shared:]) if name in own else name for name in keys}


def _told(score: Score) -> str:
    text = f"{score.method}: {score.mean:,.1f}"
    if math.isfinite(score.low + score.high):
        text += f" [{score.low:,.1f}, {score.high:,.1f}]"
    return text if score.success is None else f"{text}, success {score.success:.0%}"


def adaptation_chart(start: str, points: Sequence[tuple[float, list[float]]]) -> Chart:
    steps = [step for step, _ in points]
    losses = np.array([losses for _, losses in points], np.float64)  # (points, tasks)
    marks = [line("thin", steps, own) for own in losses.T]
    marks.append(line("c0", steps, losses.mean(axis=1), start))
    return _loss_chart(f"from {start}", marks)


def loss_curves(title: str, told: str, lines: Sequence[tuple[str, Points]]) -> Curves:
    keys = colours(name for name, _ in lines)
    marks = [
        line(keys[name], [step for step, _ in points], [loss for _, loss in points], name)
        for name, points in lines
    ]
    return Curves(title, told, [_loss_chart("", marks)], legend(keys))


def _loss_chart(name: str, marks: Sequence[Mark]) -> Chart:
    points = np.concatenate([mark.points for mark in marks])
    label = f"updates, {name}" if name else "updates"
    return Chart(f"loss {name}".strip(), axis_over([0.0, *points[:, 0].tolist()], label),
                 axis_over(points[:, 1].tolist(), "loss", is_log=True), tuple(marks))  # fmt: skip
