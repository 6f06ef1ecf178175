"""Verbs to look with: report writes a data card, view shows one episode. Bodies import lazily."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from mpdt.data.verbs.options import Names, Options, number, split_names, text_table

if TYPE_CHECKING:
    from mpdt.data.card.facts import Facts
    from mpdt.data.card.film import Film

FILMED = ("expert", "random")


@dataclass(frozen=True, kw_only=True)
class Report(Options):
    """Write the data card of a file: one HTML page that needs no network.

    What it is, how it was made and is made again, returns, ladders and references of every task,
    lengths, actions, pictures of episodes, and what verify found.

    Examples:
      mpdt-data report cheetah_dir.h5
      mpdt-data report ml10.h5 --film all -o ml10-card.html
      mpdt-data report 'parts/*.h5' --film none --no-verify
    """

    file: Annotated[Positional[str], arg(metavar="FILE[:SLICE]")]
    """File, or one slice of it; a folder, a pattern or A.h5,B.h5: several files as one. Put it
    before --film."""
    output: Annotated[Path | None, arg(aliases=["-o"], metavar="HTML")] = None
    """Page to write; default FILE with .html at its end."""
    film: Names = ()
    """Tasks of which an expert and a random episode are drawn, or all, or none; default the
    first test task."""
    no_verify: bool = False
    """Leave the checks out; they take longest."""
    replay: Annotated[str | None, arg(metavar="2%|N|all")] = None
    """Episodes that verify simulates again, as in verify; default 2%."""
    spec: Annotated[Path | None, arg(metavar="YAML")] = None
    """The datasets.yaml whose lock counts; default as in collect."""

    def run(self) -> None:
        from mpdt.data.card.card import card_page
        from mpdt.data.card.facts import Facts
        from mpdt.data.lock.file import lock_path, read_lock
        from mpdt.data.slices.several import open_ref
        from mpdt.data.spec.catalog import load_catalog
        from mpdt.data.store.reader import parse_ref
        from mpdt.data.verify.verify import verify_all
        from mpdt.disk import check_replaceable, holding
        from mpdt.draw.html import write_page
        from mpdt.errors import UsageError
        from mpdt.reading import refuse_closed

        path, _ = parse_ref(self.file)
        if path.is_dir():
            refuse_closed(path)
        if path.is_dir() and not any(path.glob("*.h5")):
            raise UsageError("a folder without data files", where=str(path),
                             hint="mpdt-train report is for runs and studies")  # fmt: skip
        data, slice_name = open_ref(self.file)
        facts = Facts.of(data, slice_name)
        part = f"-{slice_name}" if slice_name else ""
        paths = [one.path for one in data.parts] or [data.path]
        more = f"-and-{len(paths) - 1}-more" if data.parts else ""
        target = self.output or paths[0].with_name(f"{paths[0].stem}{more}{part}.html")
        with holding(target):
            check_replaceable(target, like=b"<!doctype html")
            locked = read_lock(lock_path(load_catalog(self.spec).path)).get(data.name)
            chosen = self._chosen(facts)
            report = None if self.no_verify else verify_all(paths, replay=self.replay, say=self.say)
            films, missing = self._films(facts, chosen)
            data.source.expect_there()  # or the checks and films are of another file
            text = card_page(facts, locked, report, films, missing)
            write_page(target, text)
        self.print(
            {"path": str(target), "bytes": target.stat().st_size, "films": len(films),
             "no_films": missing},
            f"{target}   {target.stat().st_size / 1e6:.2f} MB   {len(facts.tasks)} tasks   "
            f"{len(films)} episodes drawn",
        )  # fmt: skip

    def _chosen(self, facts: Facts) -> list[int]:
        """Ids to film. Raises: UsageError for an unknown task."""
        names = split_names(self.film)
        tasks = list(facts.tasks)
        if names == ("none",):
            return []
        if not names:
            complete = [task for task in tasks if set(FILMED) <= set(task.groups)] or tasks
            tasks = sorted(complete, key=lambda task: task.role == "train")[:1]
        elif names != ("all",):
            rows = [facts.data.task_row(name) for name in names]
            tasks = [task for task in tasks if task.row in rows]
        return [
            task.groups[quality].typical()
            for task in tasks
            for quality in [q for q in FILMED if q in task.groups] or [next(iter(task.groups))]
        ]

    def _films(self, facts: Facts, ids: list[int]) -> tuple[list[Film], str]:
        """The films, and why there are none."""
        from mpdt.data.card.film import shoot
        from mpdt.errors import MpdtError

        if not ids:
            return [], "not asked for; mpdt-data report --film all draws an episode of every task."
        self.say(f"film     {len(ids)} episodes")
        try:
            return shoot(facts.data, ids), ""
        except MpdtError as error:
            self.say(f"no pictures: {error.message()}")
            hint = f" To get them: {error.hint}" if error.hint else ""
            return [], f"{error.message()}.{hint}"


@dataclass(frozen=True, kw_only=True)
class View(Options):
    """Show one episode: who acted, rewards, return so far, actions, flags, goal.

    --png and --mp4 simulate it again and draw it; they need the extra `pages`.

    Examples:
      mpdt-data view cheetah_dir.h5 -e 0
      mpdt-data view ml10.h5 -e 1200 --png episode.png --mp4 episode.mp4
      mpdt-data view ml10.h5 -e 1200 --json
    """

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """File to look into."""
    episode: Annotated[int, arg(aliases=["-e"], metavar="ID")]
    """Episode, as `show --episodes` lists them."""
    png: Annotated[Path | None, arg(metavar="FILE")] = None
    """Write six frames and the reward curve there."""
    mp4: Annotated[Path | None, arg(metavar="FILE")] = None
    """Write a clip in real time there."""

    def run(self) -> None:
        from mpdt.data.card.episode import episode_facts, episode_text
        from mpdt.data.store.reader import open_dataset

        data = open_dataset(self.file)
        found = episode_facts(data, self.episode)
        written = self._pictures()
        heading = ("action", "mean", "std", "min", "max")
        cells = [
            [str(row["column"]), *(number(row[key], 3) for key in heading[1:])]
            for row in found["actions"]
        ]
        text = [*episode_text(found), "", text_table([heading, *cells])]
        text += [f"written  {path}" for path in written]
        self.print(found | {"written": [str(path) for path in written]}, "\n".join(text))

    def _pictures(self) -> list[Path]:
        from contextlib import ExitStack

        from mpdt.data.card.film import shoot
        from mpdt.data.card.picture import (
            MP4,
            PNG,
            clip_frames,
            expect_package,
            write_mp4,
            write_png,
        )
        from mpdt.data.store.reader import open_dataset
        from mpdt.disk import check_replaceable, holding

        data = open_dataset(self.file)
        with ExitStack() as stack:
            for target, package, like in (
                (self.png, "matplotlib", PNG), (self.mp4, "imageio_ffmpeg", MP4),
            ):  # fmt: skip
                if target is not None:
                    expect_package(package)
                    stack.enter_context(holding(target))
                    check_replaceable(target, like)
            if self.png is not None:
                self.say("film     6 frames")
                (film,) = shoot(self.file, [self.episode])
                data.source.expect_there()
                write_png(self.png, data, film)
            if self.mp4 is not None:
                length = int(data.episodes.length[self.episode])
                frames, fps = clip_frames(length, data.contract().step_s)
                self.say(f"film     {frames} frames")
                (film,) = shoot(self.file, [self.episode], frames)
                data.source.expect_there()
                write_mp4(self.mp4, film, fps)
        return [target for target in (self.png, self.mp4) if target is not None]
