"""Verbs that edit: merge, drop, diff. New files only; their bodies import lazily."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from mpdt.data.verbs.options import Names, Options, split_names, text_table

if TYPE_CHECKING:
    from mpdt.data.slices.diff import Diff as Differences
    from mpdt.data.store.dataset import Dataset

File = Annotated[Positional[Path], arg(metavar="FILE")]
Output = Annotated[Path, arg(aliases=["-o"], metavar="FILE")]


def _written(data: Dataset, remark: str) -> tuple[dict[str, Any], str]:
    """A new file as a result: JSON and one line."""
    found = {
        "path": str(data.path),
        "content_hash": data.content_hash,
        "parent": data.parent,
        "episodes": data.num_episodes,
        "steps": data.num_steps,
    }
    return found, (
        f"{data.path}   {data.num_episodes:,} episodes   {data.num_steps:,} steps   "
        f"content {data.content_hash[:8]}   {remark}"
    )


@dataclass(frozen=True, kw_only=True)
class Merge(Options):
    """Put the episodes of several files of one family into one file, each once.

    The files come from one root seed: cut-outs of one file, or collections of some of its tasks.
    Merging all cut-outs of a file gives its content hash again.

    Examples:
      mpdt-data merge cheetah_dir-medium.h5 cheetah_dir-expert.h5 -o both.h5
      mpdt-data merge reach.h5 push.h5 pick-place.h5 -o three.h5
      mpdt-data merge a.h5 b.h5 -o c.h5 --json
    """

    files: Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE FILE [FILE ...]")]
    """Files to merge."""
    output: Output
    """File to write."""

    def run(self) -> None:
        from mpdt.data.slices.merge import merge
        from mpdt.data.store.reader import open_dataset

        done = merge([open_dataset(path) for path in self.files], self.output)
        repeated = f", {done.num_repeated:,} episodes in more than one" if done.num_repeated else ""
        found, line = _written(done.dataset, f"from {len(self.files)} files{repeated}")
        self.print(found | {"repeated": done.num_repeated}, line)


@dataclass(frozen=True, kw_only=True)
class Drop(Options):
    """Write a file without some of its episodes; the others keep their bytes and order.

    Examples:
      mpdt-data drop ml10.h5 --episodes 12,340-349 -o ml10-clean.h5
      mpdt-data drop ml10.h5 --tasks sweep --quality random -o ml10-less.h5
      mpdt-data drop cheetah_dir.h5 --quality history -o cheetah_dir-short.h5
    """

    file: File
    """File to read; put it before --episodes and --tasks."""
    episodes: Annotated[tuple[str, ...], arg(metavar="ID[,ID-ID...]")] = ()
    """Absolute ids and ranges of ids."""
    tasks: Names = ()
    """Episodes of these tasks; with --quality, only those of that quality."""
    quality: Annotated[str | None, arg(metavar="Q")] = None
    """Episodes of this quality."""
    output: Output
    """File to write."""

    def run(self) -> None:
        from mpdt.data.slices.cut import Cut
        from mpdt.data.slices.drop import drop, parse_ids
        from mpdt.data.store.reader import open_dataset

        source = open_dataset(self.file)
        rule = Cut(tasks=split_names(self.tasks) or None, quality=self.quality)
        data = drop(source, self.output, parse_ids(self.episodes), rule)
        gone = source.num_episodes - data.num_episodes
        found, line = _written(data, f"{gone:,} dropped from {self.file}")
        self.print(found | {"dropped": gone}, line)


@dataclass(frozen=True, kw_only=True)
class Diff(Options):
    """Show in what two files differ: header, tasks, episodes, fields, slices, TTA sets.

    The exit code is 0 whether they differ or not; --json says `equal`.

    Examples:
      mpdt-data diff old/ml10.h5 ml10.h5
      mpdt-data diff cheetah_dir.h5 cheetah_dir-medium.h5
      mpdt-data diff a.h5 b.h5 --json
    """

    a: File
    """First file, A."""
    b: File
    """Second file, B."""

    def run(self) -> None:
        from mpdt.data.slices.diff import diff
        from mpdt.data.store.reader import open_dataset

        a, b = open_dataset(self.a), open_dataset(self.b)
        found = diff(a, b)
        self.print({"equal": found.is_empty} | asdict(found), "\n".join(_diff_lines(found, a, b)))


def _diff_lines(found: Differences, a: Dataset, b: Dataset) -> list[str]:
    if found.is_empty:
        return [f"equal: content {a.content_hash[:8]}, headers, slices and TTA sets"]
    content = f"content  {a.content_hash[:8]} and {b.content_hash[:8]}"
    lines = [content + (" (equal episodes)" if found.same_content else "")]
    lines += [f"header   {line}" for line in found.header]
    lines += [f"task     {name}: only in A" for name in found.tasks_only_a]
    lines += [f"task     {name}: only in B" for name in found.tasks_only_b]
    if found.runs:
        heading = ("task", "quality", "same", "only A", "only B", "changed")
        rows = [
            [one.task, one.quality, *(f"{n:,}" for n in (one.same, one.only_a, one.only_b,
                                                           one.changed))]
            for one in found.runs
        ]  # fmt: skip
        lines += ["", text_table([heading, *rows], numbers_from=2)]
        lines += [
            f"  {one.task} {one.quality}: episode {i} of A, {j} of B: {', '.join(fields)}"
            for one in found.runs
            for i, j, fields in one.examples
        ]
    return lines + [""] * bool(found.slices or found.tta) + [*found.slices, *found.tta]
