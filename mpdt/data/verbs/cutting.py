"""Verb that cuts data: split. Its body imports lazily."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from mpdt.data.verbs.options import Names, Options, split_names


@dataclass(frozen=True, kw_only=True)
class Split(Options):
    """Cut episodes out of a dataset file, into a file of their own or a named slice.

    Without FILE: every finished dataset file in this folder that is not itself a cut-out.

    Examples:
      mpdt-data split --quality medium
      mpdt-data split ml10.h5 --tasks reach,push --episodes 10 -o few.h5
      mpdt-data split cheetah_dir.h5 --quality expert --name best
      mpdt-data split ml10.h5 --validation 0.1
    """

    file: Annotated[Positional[str | None], arg(metavar="FILE[:SLICE]")] = None
    """File to cut; put it before --tasks."""
    quality: Annotated[str | None, arg(metavar="Q")] = None
    """Only random, medium, expert, history or policy."""
    tasks: Names = ()
    """Only these tasks."""
    train: bool = False
    """Only tasks to train on."""
    test: bool = False
    """Only tasks to test on."""
    progress: Annotated[str | None, arg(metavar="A:B")] = None
    """Only episodes from A to B of the way from untrained (0) to final (1)."""
    return_top: Annotated[float | None, arg(metavar="SHARE")] = None
    """Only that share of each task's episodes, by highest return."""
    episodes: Annotated[int | None, arg(metavar="N")] = None
    """At most N per task; 10 are inside 100."""
    validation: Annotated[float | None, arg(metavar="SHARE")] = None
    """Add slice `validation` to the file instead: that share of what training tasks have, for
    mpdt-train --validation. Tasks that are only tested on are never in it."""
    by: Annotated[Literal["episode", "goal", "task"] | None, arg(metavar="X")] = None
    """What --validation holds out: episodes of every task and quality (default), all episodes of
    some goals of every task, or all of some tasks."""
    per_task: bool = False
    """One file per task."""
    name: Annotated[str | None, arg(metavar="S")] = None
    """Add slice S to the file instead; use it as FILE:S."""
    output: Annotated[Path | None, arg(aliases=["-o"], metavar="FILE")] = None
    """File to write; default FILE-<what was chosen>.h5 beside the source."""

    def run(self) -> None:
        from mpdt.data.slices.choice import parse_progress
        from mpdt.data.slices.cut import Cut
        from mpdt.data.slices.split import split
        from mpdt.errors import UsageError

        if self.train and self.test:
            raise UsageError("--train and --test together", hint="leave both out for all tasks")
        tasks = split_names(self.tasks)
        if self.file is None and (files := [name for name in tasks if name.endswith(".h5")]):
            raise UsageError(f"'{files[0]}' was read as a task", hint="put FILE before --tasks")
        cut = Cut(
            quality=self.quality,
            tasks=tasks or None,
            role="train" if self.train else "test" if self.test else None,
            progress=None if self.progress is None else parse_progress(self.progress),
            return_top=self.return_top,
            episodes=self.episodes,
            validation=self.validation,
            by=self.by,
        )
        results = split(
            self.file, cut, per_task=self.per_task, name=self.name, output=self.output,
            on_skip=lambda reason: self.say(f"skipped  {reason}"),
        )  # fmt: skip
        found = [
            {
                "path": str(one.path),
                "slice": one.slice,
                "source": str(one.source),
                "episodes": one.num_episodes,
                "steps": one.num_steps,
            }
            for one in results
        ]
        lines = [
            f"{one.path}{f':{one.slice}' if one.slice else ''}   "
            f"{one.num_episodes:,} episodes   {one.num_steps:,} steps   from {one.source}"
            for one in results
        ]
        self.print(found, "\n".join(lines))
