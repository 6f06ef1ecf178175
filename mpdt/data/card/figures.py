"""Figures of a data card: which numbers of a file stand in which chart."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mpdt.data.card.facts import Facts, TaskFacts
from mpdt.draw.chart import (
    Axis,
    Chart,
    Dot,
    Floats,
    Mark,
    axis_over,
    band,
    line,
    row_chart,
    rule,
    steps,
)

BINS = 24
ROWS = 25  # tasks in one overview chart
ACTION_EPISODES = 100  # of each quality; spread evenly, so that a card takes seconds
PROGRESS = "progress of who acted: 0 untrained, 1 final"
LEVELS = (-1.0, 2.0)  # normalised returns beyond stand at the edge
TASK_BLIND = {"zero": "zero action", "constant": "best constant action"}


def overviews(facts: Facts) -> list[Chart]:
    """Normalised return of every task: stored qualities and task-blind policies."""
    rows = [(task.name, _levels(task)) for task in facts.tasks]
    axis = axis_over(
        [0.0, 1.0, *(d.value for _, dots in rows for d in dots)], "0 = random, 1 = expert"
    )
    margin = 0.04 * (axis.high - axis.low)  # a dot at the end keeps clear of the names
    axis = Axis(max(axis.low, LEVELS[0]) - margin, min(axis.high, LEVELS[1]) + margin, axis.label)
    if not any(math.isfinite(dot.value) for _, dots in rows for dot in dots):
        return []
    parts = -(-len(rows) // ROWS)
    each = -(-len(rows) // parts)
    return [
        row_chart("normalised return per task", rows[first : first + each], axis)
        for first in range(0, len(rows), each)
    ]


def _levels(task: TaskFacts) -> list[Dot]:
    """Task-blind policies last: rings around the dots they lie on."""
    found = [(quality, quality, group.mean) for quality, group in task.groups.items()]
    found += [(name, words, task.references[name].mean) for name, words in TASK_BLIND.items()]
    return [
        Dot(key, task.level(mean), told=f"{task.name}, {words}: {task.level(mean):.2f}")
        for key, words, mean in found
    ]


def returns_chart(task: TaskFacts) -> Chart:
    """Share of the episodes of each quality over their return; task-blind policies as lines."""
    lines = {name: task.references[name].mean for name in TASK_BLIND}
    values = [group.returns for group in task.groups.values()]
    axis = axis_over([*np.concatenate(values).tolist(), *lines.values()], "return")
    marks = _histograms({q: g.returns for q, g in task.groups.items()}, axis)
    marks += [
        rule(name, value, f"{TASK_BLIND[name]}: {value:,.1f}")
        for name, value in lines.items() if math.isfinite(value)
    ]  # fmt: skip
    return _shares(f"{task.name}: returns", axis, marks)


def _histograms(values: dict[str, Floats], axis: Axis) -> list[Mark]:
    """One outline per quality, heights in percent."""
    edges = np.linspace(axis.low, axis.high, BINS + 1)
    marks = []
    for quality, numbers in values.items():
        known = np.clip(numbers[np.isfinite(numbers)], axis.low, axis.high)
        counts, _ = np.histogram(known, edges)
        told = f"{quality}: {len(numbers):,}"
        marks.append(steps(quality, edges, 100.0 * counts / max(1, len(known)), told))
    return marks


def _shares(title: str, axis: Axis, marks: Sequence[Mark]) -> Chart:
    tallest = max((m.points[:, 1].max() for m in marks if m.kind == "area"), default=1.0)
    return Chart(title, axis, Axis(0.0, float(max(tallest, 1e-9)), "% of episodes"), tuple(marks))


def ladder_chart(task: TaskFacts) -> Chart | None:
    """Return of the history episodes over the progress of whoever acted; None without any
    whose progress is known.

    The band holds the middle 80 % of the episodes of a rung; dots are the other qualities.
    """
    group = task.groups.get("history")
    if group is None or group.progress.min() < 0:  # -1 is unknown
        return None
    progress = np.unique(group.progress)
    rungs = [group.returns[group.progress == at] for at in progress]
    low, high = (np.array([np.quantile(rung, q) for rung in rungs]) for q in (0.1, 0.9))
    means = np.array([rung.mean() for rung in rungs])
    marks = [band("history", progress, low, high), line("history", progress, means)]
    ends = [low.min(), high.max()]
    for quality, other in task.groups.items():
        place = float(np.median(other.progress))
        if quality != "history" and place >= 0:
            told = f"{quality}: {other.mean:,.1f}"
            marks.append(Mark("dots", quality, np.array([[place, other.mean]]), told))
            ends.append(other.mean)
    return Chart(f"{task.name}: ladder", Axis(0.0, 1.0, PROGRESS),
                 axis_over(ends, "return"), tuple(marks))  # fmt: skip


def ladders_chart(facts: Facts) -> Chart | None:
    """Normalised ladder of every task as a thin line, and their median."""
    lines: list[Mark] = []
    levels: dict[float, list[float]] = {}
    for task in facts.tasks:
        group = task.groups.get("history")
        if group is None or group.progress.min() < 0 or math.isnan(task.level(0.0)):
            continue
        progress = np.unique(group.progress)
        own = [task.level(float(group.returns[group.progress == p].mean())) for p in progress]
        lines.append(line("thin", progress, np.array(own), task.name))
        for at, level in zip(progress.tolist(), own, strict=True):
            levels.setdefault(round(at, 3), []).append(level)
    if not lines:
        return None
    places = sorted(at for at, found in levels.items() if 2 * len(found) >= len(lines))
    middle = np.array([float(np.median(levels[at])) for at in places])
    axis = axis_over([0.0, 1.0, *(y for mark in lines for y in mark.points[:, 1])], "normalised")
    axis = Axis(max(axis.low, LEVELS[0]), min(axis.high, LEVELS[1]), axis.label)
    marks = (*lines, line("history", np.array(places), middle, "median of the tasks"))
    return Chart("ladders of all tasks", Axis(0.0, 1.0, PROGRESS), axis, marks)


def lengths_chart(facts: Facts) -> Chart | None:
    """Lengths of the episodes per quality; None where all are equally long."""
    every = np.concatenate(list(facts.lengths.values()))
    if len(every) == 0 or every.min() == every.max():
        return None
    axis = axis_over([0.0, float(every.max())], "steps")
    values = {quality: found.astype(np.float64) for quality, found in facts.lengths.items()}
    return _shares("episode lengths", axis, _histograms(values, axis))


def action_charts(facts: Facts) -> list[Chart]:
    """Distribution of every action component per quality."""
    data, family = facts.data, facts.family
    samples = {quality: _some_actions(facts, quality) for quality in facts.qualities}
    charts = []
    for column in range(data.action_size):
        values = {quality: found[:, column] for quality, found in samples.items()}
        ends = [float(v) for found in values.values() for v in (found.min(), found.max())]
        if family is not None:
            ends = [family.action_low, family.action_high]
        axis = axis_over(ends, f"action {column}")
        chart = _shares(f"action {column}", axis, _histograms(values, axis))
        charts.append(Chart(chart.title, chart.x, Axis(0.0, chart.y.high, "% of steps"),
                            chart.marks))  # fmt: skip
    return charts


def _some_actions(facts: Facts, quality: str) -> Floats:
    """(n, A) actions of episodes spread evenly over those of a quality; finite ones."""
    data = facts.data
    ids = np.concatenate([t.groups[quality].ids for t in facts.tasks if quality in t.groups])
    chosen = ids[np.linspace(0, len(ids) - 1, min(len(ids), ACTION_EPISODES)).astype(int)]
    found = np.concatenate([np.asarray(data.episode(int(i)).actions, np.float64) for i in chosen])
    known: Floats = found[np.isfinite(found).all(axis=1)]
    return known if len(known) else np.zeros((1, data.action_size))
