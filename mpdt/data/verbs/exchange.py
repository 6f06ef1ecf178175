"""Verbs that share data: import and export."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from mpdt.data.verbs.options import Names, Options

if TYPE_CHECKING:
    from mpdt.data.exchange.incoming import Incoming
    from mpdt.data.exchange.treatment import Rules


@dataclass(frozen=True, kw_only=True)
class Import(Options):
    """Bring data of another format into a dataset file; several sources become one file.

    Everything is checked, and a pickle cannot run code. What a source does not say about its
    origin stays unknown; references are those on record for its tasks and horizon. `tta FILE` adds
    a set for test-time adaptation.

    Examples:
      mpdt-data import prompt-dt/ --from promptdt --family cheetah_vel -o vel.h5
      mpdt-data import metaworld_prompts/ --from mtdiff --family ml10 --hide-goal -o ml10-mtdiff.h5
      mpdt-data import my_sets/ --from minari --family-of mine --test far -o mine.h5
      mpdt-data import tree/ --from lerobot --family-of mine -o mine.h5
    """

    sources: Annotated[Positional[tuple[Path, ...]], arg(metavar="SRC...")]
    """Files, or folders to look for them in."""
    format: Annotated[str, arg(name="from", metavar="FMT")]
    """minari, parquet, npz, lerobot, d4rl, promptdt or mtdiff."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="FILE")]
    """File to write; nothing is replaced."""
    family: Annotated[str | None, arg(metavar="F")] = None
    """Family of the tasks; our own exports know it."""
    family_of: Annotated[str | None, arg(metavar="NAME")] = None
    """Make a family of their own of the sources (minari, d4rl, npz or lerobot); without --env
    nobody simulates it."""
    env: bool = False
    """With --family-of and minari, simulate by the gymnasium environment that the sets record: for
    replay, references of zero and random, and judging. It is checked first."""
    task_from: Annotated[str, arg(metavar="source|folder|COLUMN")] = "source"
    """With --family-of, what names the tasks: files, sets or the texts of a LeRobot tree; the
    folders they are in; or a column of the tree."""
    states: Annotated[Names, arg(metavar="COLUMN,...")] = ()
    """With --family-of and lerobot, the columns that are the observation, side by side; default:
    observation.state."""
    test: Names = ()
    """With --family-of, the tasks that are only tested on."""
    task: Annotated[str | None, arg(metavar="NAME")] = None
    """Task of all episodes, where the sources do not say."""
    quality: Annotated[str | None, arg(metavar="Q")] = None
    """Quality of all episodes, where the sources do not say; unknown takes back what they say."""
    horizon: Annotated[int | None, arg(metavar="STEPS")] = None
    """Time limit of the episodes; default: the family's."""
    clip_actions: bool = False
    """Clip actions to the bounds, as the simulator does, instead of refusing them."""
    hide_goal: bool = False
    """Set the columns to 0 in which the family hides the goal."""
    license: Annotated[str, arg(metavar="SPDX")] = "NOASSERTION"
    """Licence of the sources, where they do not say."""

    def run(self) -> None:
        from mpdt.data.collect.standing import with_references
        from mpdt.data.exchange import incoming
        from mpdt.data.slices.standard import standard_additions

        found = self._read()
        if self.env:
            from mpdt.data.verify.imported import simulated

            found = simulated(found, self.say)
        header, remarks = with_references(found.header)
        found = replace(found, header=header, remarks=(*found.remarks, *remarks))
        dataset = incoming.store(found, self.output, standard_additions)
        for remark in found.remarks:
            self.say(remark)
        result = {
            "path": str(dataset.path),
            "episodes": dataset.num_episodes,
            "steps": dataset.num_steps,
            "content_hash": dataset.content_hash,
            "remarks": list(found.remarks),
        }
        self.print(
            result,
            f"{dataset.path}   {dataset.num_episodes:,} episodes   {dataset.num_steps:,} steps   "
            f"content {dataset.content_hash[:8]}",
        )

    def _read(self) -> Incoming:
        from mpdt.data.exchange import formats
        from mpdt.data.exchange.own_family import read
        from mpdt.data.exchange.own_sources import Asked
        from mpdt.data.verbs.options import split_names
        from mpdt.errors import UsageError

        if self.family_of is None:
            if self.test or self.states or self.env or self.task_from != "source":
                raise UsageError("--test, --states, --env, --task-from are of a family of its own",
                                 hint="add --family-of NAME")  # fmt: skip
            return formats.read(self.format, self.sources, self._rules(), self.output.stem)
        if self.family or self.clip_actions or self.hide_goal:
            raise UsageError("--family, --clip-actions and --hide-goal are of a known family",
                             where="--family-of", hint="leave them out")  # fmt: skip
        asked = Asked(self.format, self.family_of, self.task_from, self.task, self.quality,
                      split_names(self.test), self.horizon, self.license,
                      split_names(self.states), self.env)  # fmt: skip
        return read(self.sources, asked, self.output.stem)

    def _rules(self) -> Rules | None:
        from mpdt.data.exchange.foreign import quality_code
        from mpdt.data.exchange.treatment import Rules
        from mpdt.data.spec.tasks import get_family
        from mpdt.data.store.licence import UNKNOWN
        from mpdt.errors import UsageError

        if self.quality is not None:
            quality_code(self.quality)
        if self.family is None:
            told = (self.task, self.quality, self.horizon, self.clip_actions, self.hide_goal)
            if any(told) or self.license != UNKNOWN:
                raise UsageError("options for foreign data need a family", where="--family",
                                 hint="name it, or leave them out: our own exports know all "
                                      "that")  # fmt: skip
            return None
        family = get_family(self.family)
        if self.task is not None:
            family.task(self.task)
        return Rules(
            format=self.format, family=family,
            horizon=family.horizon if self.horizon is None else self.horizon,
            task=self.task, quality=self.quality, clip_actions=self.clip_actions,
            hide_goal=self.hide_goal, license=self.license,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Export(Options):
    """Write a dataset file, or a slice of it, in a format of other libraries.

    minari, minari-arrow, parquet and npz lose no episode data: importing them again gives the same
    content hash. TTA sets and named slices stay behind in all formats.

    Examples:
      mpdt-data export cheetah_dir.h5 --to minari -o datasets
      mpdt-data export ml10.h5:expert --to parquet
      mpdt-data export cheetah_vel.h5 --to promptdt -o prompt-dt
    """

    file: Annotated[Positional[str], arg(metavar="FILE[:SLICE]")]
    format: Annotated[str, arg(name="to", metavar="FMT")]
    """minari (hdf5), minari-arrow, parquet, npz, lerobot, d4rl, ogbench or promptdt."""
    slice: Annotated[str | None, arg(metavar="S")] = None
    """Only this slice; the same as FILE:S."""
    link: bool = False
    """minari: refer to FILE's arrays instead of copying them; do not move FILE then."""
    output: Annotated[Path | None, arg(aliases=["-o"], metavar="FOLDER")] = None
    """Folder to write; default FILE-FMT. Nothing is replaced."""

    def run(self) -> None:
        from mpdt.data.exchange import formats
        from mpdt.data.exchange.selection import Selection
        from mpdt.data.store.reader import open_dataset, parse_ref
        from mpdt.errors import DataError, UsageError

        path, name = parse_ref(self.file)
        if name and self.slice:
            raise UsageError("two slices", where=self.file, hint="leave out --slice")
        dataset = open_dataset(path)
        name = name or self.slice
        chosen = Selection(dataset, dataset.select(slice=name), name or "")
        if not len(chosen.ids):
            raise DataError("an empty slice", where=self.file)
        target = self.output or Path(f"{path.stem}-{self.format}")
        lost = formats.write(self.format, chosen, target, self.link)
        if lost:
            self.say(f"not in a {self.format} export: {lost}")
        result = {
            "path": str(target),
            "episodes": len(chosen.ids),
            "steps": chosen.num_steps,
            "content_hash": chosen.content_hash,
            "lost": lost,
        }
        self.print(
            result,
            f"{target}   {len(chosen.ids):,} episodes   {chosen.num_steps:,} steps   "
            f"content {chosen.content_hash[:8]}",
        )
