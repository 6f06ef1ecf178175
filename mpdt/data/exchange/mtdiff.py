"""MTDiff's Meta-World prompts: `<task>-v2_prompt.npy`, an object array of ten episodes (in only).

A dict per episode, as in Prompt-DT's pickles; `terminals` are floats, 1.0 on the last row, a
time limit. The goal is visible in columns 36:39 and some actions are as the script gave them,
beyond the bounds. The goal that the simulator was reset with is not in the file: unknown.

Source: the public repository of MTDiff (He et al. 2023), folder metaworld_prompts.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from mpdt.data.exchange import foreign
from mpdt.data.exchange.claims import Said
from mpdt.data.exchange.folder import files_below, left_out
from mpdt.data.exchange.foreign import Source, quality_code
from mpdt.data.exchange.incoming import Incoming
from mpdt.data.exchange.promptdt import raw_episode
from mpdt.data.exchange.treatment import RawEpisode, Rules
from mpdt.data.exchange.unpickle import load_object_array
from mpdt.errors import DataError, UsageError

_NAME = re.compile(r"(?P<task>.+)-v\d_prompt\.npy")
_VERSION = re.compile(r"-v\d$")


def read(paths: Sequence[Path], rules: Rules | None, name: str) -> Incoming:
    """The prompts of those tasks that the family has; others are skipped with a remark.

    Raises: UsageError for a family of another simulator; FormatError, DataError, ShapeError
        naming file and episode.
    """
    rules = foreign.given(rules)
    if "metaworld" not in rules.family.packages:
        raise UsageError(f"{rules.family.name} is not of Meta-World", where="--family",
                         hint="ml10, ml45, mt10 or mt50")  # fmt: skip
    known = {task.name: task for task in rules.family.tasks}
    quality = quality_code(rules.quality or "unknown")
    files = files_below(paths, ".npy")
    sources, remarks = [], left_out(paths, files)
    for path in files:
        match = _NAME.fullmatch(path.name)
        named = match["task"] if match else ""
        if named and named not in known and rules.task is None:
            remarks.append(f"skipped {path}: no task of {rules.family.name}")
            continue
        task = Said(task=named, by="its name").settled(rules, str(path)).task
        if not task:
            remarks.append(f"skipped {path}: not <task>-v2_prompt.npy")
            continue
        sources.append(Source(path, known[task], quality, partial(_episodes, path, task)))
    return foreign.incoming(sources, rules, name, remarks)


def _episodes(path: Path, task: str) -> Iterator[RawEpisode]:
    for number, episode in enumerate(load_object_array(path)):
        where = f"{path}: episode {number}"
        found = raw_episode(episode, None, where)
        # Each dict says its task too.
        if isinstance(said := episode.get("task"), str) and _VERSION.sub("", said) != task:
            raise DataError("an episode of another task than its file", where=where,
                            expected=task, found=said)  # fmt: skip
        yield found
