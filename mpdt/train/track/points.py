"""Points: what a tracker is told of a run, out of metrics.jsonl and results.json.

    a line of metrics.jsonl      one point: its numbers under their phase
    results.json                 one point: what each method earns, by block, and maps of prompts

A run's points are numbered from 0 in the order of its lines, so that whoever has n of them lacks
those from n on.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from mpdt.train.evaluate.score import MEAN
from mpdt.train.run.results import scores_in

Pixels = npt.NDArray[np.uint8]
_NO_NUMBERS = ("phase", "step", "start", "task")


@dataclass(frozen=True)
class Point:
    """What happened at one update.

    Args:
        number: place among the points of the run.
        at: update of its phase; of results all updates of the student.
        scalars: `student/action_loss`, `test/MPDT infer/return`; all finite.
        images: (H, W, 3).
    """

    number: int
    at: int
    scalars: Mapping[str, float] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)
    images: Mapping[str, Pixels] = field(default_factory=dict)

    def below(self, name: str) -> Point:
        """The same with every name below `name`."""
        parts = ({f"{name}/{key}": value for key, value in one.items()}
                 for one in (self.scalars, self.texts, self.images))  # fmt: skip
        scalars, texts, images = parts
        return replace(self, scalars=scalars, texts=texts, images=images)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Facts:
    """What a tracker shows of a run beside its points.

    Args:
        run: names it wherever names must not meet: that of the folder would come again.
        settings: nested, JSON values.
        described: data, language model, versions: texts by name.
        tags: short words to find it by, such as `data-1a2b3c4d5e6f`.
    """

    run: str
    name: str
    settings: Mapping[str, Any]
    described: Mapping[str, str]
    tags: Sequence[str]


def point_of(record: Mapping[str, Any], number: int, tasks: Sequence[str] = ()) -> Point:
    """A line as a point.

        {"phase": "student", "step": 50, "loss": 0.2}      student/loss 0.2 at 50
        {"phase": "adapt", "start": "cross", "step": 1,    adapt cross/losses mean 0.3 at 1, and
         "losses": [0.2, 0.4]}                             0.2, 0.4 under the names of the tasks

    Args:
        tasks: of which a list has one number each.
    """
    words = [str(record[key]) for key in ("phase", "start") if record.get(key)]
    group, scalars, texts = " ".join(words), dict[str, float](), dict[str, str]()
    task = f" {record['task']}" if record.get("task") else ""
    for key, value in record.items():
        if key in _NO_NUMBERS:
            continue
        if isinstance(value, list) and value and all(map(_is_number, value)):
            scalars[f"{group}/{key} {MEAN}"] = float(np.mean(value))
            names = tasks if len(tasks) == len(value) else [str(i) for i in range(len(value))]
            scalars |= {f"{group}/{key} {n}": float(v) for n, v in zip(names, value, strict=True)}
        elif _is_number(value):
            scalars[f"{group}/{key}{task}"] = float(value)
        else:
            texts[f"{group}/{key}{task}"] = json.dumps(value)
    return Point(number, int(record.get("step", 0)), _finite(scalars), texts)


def point_of_results(
    results: Mapping[str, Any], maps: Mapping[str, Pixels], number: int
) -> Point:  # fmt: skip
    """Return, level and success of every method, of the mean and of each task; prompts' maps."""
    scalars = {}
    for score in scores_in(results):
        group = f"{score.block} {score.task}"
        scalars[f"{group} return/{score.method}"] = score.mean
        scalars[f"{group} level/{score.method}"] = score.normalised
        if score.success is not None:
            scalars[f"{group} success/{score.method}"] = score.success
    images = {f"prompts/{name}": pixels for name, pixels in maps.items()}
    at = int(results.get("updates", {}).get("student", 0))
    return Point(number, at, _finite(scalars), {}, images)


def _finite(scalars: Mapping[str, float]) -> dict[str, float]:
    return {key: value for key, value in scalars.items() if math.isfinite(value)}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
