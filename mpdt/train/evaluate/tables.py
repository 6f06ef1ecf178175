"""Scores -> tables, for the terminal and report.md (`draw/table.py` draws both).

Two tables per block of tasks: every task beside every method, and the mean over tasks with
its interval. The trivial rows (zero action, random, best constant) stand in every table:
without them a few dozen return points look like learning.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from mpdt.draw.table import Table
from mpdt.train.evaluate.score import MEAN, Block, Score

BLOCKS: tuple[tuple[Block, str], ...] = (("train", "training"), ("test", "test"))
NOT_MEASURED = "not measured"
NORMALISED = "normalised = (return - random) / (expert - random), mean over tasks."
"""What stands below the tables of a page."""


def build_tables(scores: Sequence[Score], prompts: bool = True) -> list[Table]:
    """Per block: tasks x methods, then the mean over tasks. Order of methods: as given.

    Args:
        prompts: the methods are ours, and titles say behind which prompts they act.
    """
    tables = []
    for block, kind in BLOCKS:
        chosen = [score for score in scores if score.block == block]
        if not chosen:
            continue
        title = f"{kind.capitalize()} tasks"
        if prompts:
            own = "Training tasks (each with its own prompt)"
            title = test_title(scores) if block == "test" else own
        methods = list(dict.fromkeys(score.method for score in chosen))
        tasks = list(dict.fromkeys(score.task for score in chosen))
        has_mean = tasks[-1] == MEAN
        at = {(score.task, score.method): score for score in chosen}
        rows = tuple(
            (task, *(_cell(at.get((task, method))) for method in methods)) for task in tasks
        )
        has_success = any(score.success is not None for score in chosen)
        note = ": return [95 % interval over evaluation episodes]"
        note += " success (normalised)" if has_success else " (normalised)"
        verdicts = tuple(_verdicts(chosen, methods, kind))
        tables.append(Table(title + note, ("task", *methods), rows, verdicts, int(has_mean)))
        told = any(score.reads for score in chosen)
        tried = any(score.own_steps is not None for score in chosen)
        means = tuple(
            _mean_row(method, at.get((MEAN, method)), has_success, told, tried)
            for method in methods
        )
        columns = ["method", "mean return", "95 % interval", "normalised"]
        columns += ["success"] if has_success else []
        columns += ["reads"] if told else []
        columns += ["own steps per task"] if tried else []
        tables.append(Table(f"{title}: mean over tasks", tuple(columns), means))
    return tables


def test_title(scores: Sequence[Score]) -> str:
    """Whether training knew the test tasks, where training tasks are in the scores to tell by; what
    each method read stands in its column."""
    test, train = (
        {score.task for score in scores if score.block == block} - {MEAN}
        for block in ("test", "train")
    )
    if not train:
        return "Test tasks"
    seen = test & train
    said = "never trained on"
    if seen:
        said = f"{len(seen)} of {len(test)} are training tasks as well"
        said = "the training tasks again, behind other prompts" if seen == test else said
    return f"Test tasks ({said})"


def _verdicts(scores: Sequence[Score], methods: Sequence[str], kind: str) -> Iterator[str]:
    for method in methods:
        verdicts = [
            score.beats_trivial
            for score in scores
            if score.method == method and score.task != MEAN and score.beats_trivial is not None
        ]
        if verdicts:
            yield (
                f"{method} beats zero action and random (intervals apart): "
                f"{sum(verdicts)} of {len(verdicts)} {kind} tasks"
            )


def _number(value: float) -> str:
    return f"{value:.1f}" if abs(value) < 1000 else f"{value:.0f}"


def _interval(score: Score) -> str:
    known = score.low == score.low
    return f"[{_number(score.low)}, {_number(score.high)}]" if known else "-"


def _cell(score: Score | None) -> str:
    if score is None or score.mean != score.mean:
        return NOT_MEASURED
    parts = [_number(score.mean)]
    if score.low == score.low:
        parts.append(_interval(score))
    if score.success is not None:
        parts.append(f"{score.success:.0%}")
    if score.low == score.low and score.normalised == score.normalised:
        parts.append(f"({score.normalised:.2f})")
    return " ".join(parts)


def _mean_row(
    method: str, score: Score | None, has_success: bool, told: bool, tried: bool
) -> tuple[str, ...]:
    if score is None or score.mean != score.mean:
        cells = [NOT_MEASURED, "-", "-", "-"]
    else:
        success = "-" if score.success is None else f"{score.success:.0%}"
        known = score.normalised == score.normalised
        level = f"{score.normalised:.2f}" if known else "-"
        cells = [_number(score.mean), _interval(score), level, success]
    reads = [(score.reads if score else None) or "-"] if told else []
    steps = "-" if score is None or score.own_steps is None else f"{score.own_steps:,.0f}"
    return (method, *cells[: 4 if has_success else 3], *reads, *([steps] if tried else []))
