"""LeRobot trees in, as episodes of a family that is known.

The format has no observation after an episode's last step, so that step is left out, and with it
how the episode ended: each is cut off where its rows end, and the file has no time limit. Videos
and images are left out too.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from mpdt.data.exchange import foreign
from mpdt.data.exchange.foreign import Source, quality_code
from mpdt.data.exchange.incoming import Incoming
from mpdt.data.exchange.lerobot_rows import ACTION, REWARD, Label
from mpdt.data.exchange.lerobot_tree import (
    STATES,
    Tree,
    by_task,
    episodes,
    left_out,
    trees,
    wanted_of,
)
from mpdt.data.exchange.treatment import Rules
from mpdt.data.spec.tasks import Family, Task
from mpdt.errors import ShapeError, UsageError, nearest, quoted

_VERSION = re.compile(r"-v[0-9]+$")  # reach-v2 and reach-v3 are one task


def read(paths: Sequence[Path], rules: Rules | None, name: str) -> Incoming:
    """Trees of one family. A task is known by its text: `reach`, `reach-v3` or `ml10: reach`; or
    `--task` names that of all.

    Raises: UsageError, FormatError, DataError, ShapeError naming file and episode.
    """
    rules = replace(foreign.given(rules), any_length=True)
    sources, remarks = [], []
    for tree in trees(paths):
        wanted = wanted_of(tree, [_state_column(tree, rules.family)])
        for path, label in by_task(tree, wanted):
            task, quality = _task(tree, label, rules), quality_code(rules.quality or "unknown")
            sources.append(Source(path, task, quality, partial(episodes, path, wanted, label)))
        remarks += left_out(tree, wanted)
    return foreign.incoming(sources, rules, name, remarks)


def _task(tree: Tree, number: Label, rules: Rules) -> Task:
    """Raises: FormatError for a number without text; UsageError for a text that is no task."""
    if rules.task is not None:
        return rules.family.task(rules.task)
    said = tree.text_of(number)
    word = _VERSION.sub("", said.removeprefix(f"{rules.family.name}:").strip())
    known = {task.name: task for task in rules.family.tasks}
    if word not in known:
        raise UsageError(f"{rules.family.name} has no task {quoted(said)}", where=str(tree.folder),
                         found=nearest(word, known), hint="name the task of all with --task"
                         )  # fmt: skip
    return known[word]


def _state_column(tree: Tree, family: Family) -> str:
    """The column that is as wide as the family's observations.

    Raises: ShapeError naming those that are there; for actions or rewards of another width.
    """
    for name, width in ((ACTION, family.action_size), (REWARD, 1)):
        if tree.widths.get(name) != width:
            raise ShapeError(f"no {name} of {width} numbers", where=str(tree.folder),
                             expected=f"those of {family.name}",
                             found=str(tree.widths.get(name, "none")))  # fmt: skip
    states = {name: tree.widths[name] for name in STATES if name in tree.widths}
    fits = [name for name, width in states.items() if width == family.observation_size]
    if not fits:
        raise ShapeError(f"no observation of {family.observation_size} numbers",
                         where=str(tree.folder), expected=f"those of {family.name}",
                         found=", ".join(f"{k} of {v}" for k, v in states.items()) or "none",
                         )  # fmt: skip
    return fits[0]
