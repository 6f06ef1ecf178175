"""`--keep FILE.h5`: the episodes of an evaluation as data files, one for each row of the table.

    FILE.h5 -> FILE-own.h5, FILE-cross.h5, ...        FILE.h5 itself for a single policy

One file cannot hold two rows: they begin in the same states, which are one place in a file.
Seeds are the evaluation's, so `verify` replays them; quality is `policy`, as in roll-outs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mpdt.data.collect.origin import Acted, Origin, header_of_policy
from mpdt.data.collect.plan import most_bytes
from mpdt.data.collect.rollouts import NAME, level_on
from mpdt.data.slices.standard import standard_additions
from mpdt.data.store.layout import checked_name
from mpdt.data.store.reader import open_dataset
from mpdt.data.store.sources import EpisodeSource, FileHeader
from mpdt.data.store.writer import write_file
from mpdt.disk import check_replaceable, expect_folder, expect_room, holding
from mpdt.errors import DataError, FormatError
from mpdt.train.evaluate.rollout import Kept
from mpdt.train.evaluate.score import Reads
from mpdt.train.run.bench import Bench

VERB = "evaluate"


@dataclass
class Keeper:
    """Where episodes go, and what is said of who acts.

    Args:
        target: the name that was asked for.
        actor: the run or policy by name.
        facts: of it, as JSON values.
        say: told of each file.
        single: one policy is judged, in one file.
    """

    target: Path
    actor: str
    facts: Mapping[str, Any]
    say: Callable[[str], None]
    single: bool = False

    def __post_init__(self) -> None:
        self.target = self.target.absolute()  # a policy may go to another folder
        expect_folder(self.target.parent)
        with holding(self.target, amends=True, wait_s=0):
            check_replaceable(self.target)  # the first row comes behind references and adaptation

    @contextmanager
    def row(
        self, bench: Bench, name: str, method: str, fingerprint: bytes, rows: Sequence[int],
        episodes: int, reads: Reads | None = None, seed: int | None = None,
    ) -> Iterator[KeptRow]:  # fmt: skip
        """Where the episodes of one row will go; asked before they are run, and held until then.

        Args:
            rows: of the table of tasks.
            episodes: of each task.
            seed: root of their seeds; None = evaluation's.
        Raises: DataError if something else is there; BusyError; StorageError.
        """
        path = self.target
        if not self.single:
            path = path.with_name(f"{path.stem}-{checked_name(name)}{path.suffix}")
        facts = {**self.facts, "method": method, "start": name, "reads": reads or "nothing"}
        label = self.actor if self.single else f"{self.actor} {name}"
        seed = bench.settings.seed if seed is None else seed
        spec = {"seed": seed, "horizon": bench.horizon, "episodes": {NAME: episodes}}
        acted = Acted(label, fingerprint, facts)
        row = KeptRow(path, bench, rows, acted, Kept(fingerprint), self.say, spec)
        number = len(rows) * episodes
        needed = most_bytes(bench.material.family, number * bench.horizon, number)
        # Judging takes hours: what another one keeps there meanwhile would be replaced at the end.
        with holding(path, amends=True, wait_s=0):
            row.check()
            expect_room(path, needed, "the episodes", "--keep")
            yield row


@dataclass
class KeptRow:
    """One file to be; `spec` is what its spec says of the judgement."""

    path: Path
    bench: Bench
    rows: Sequence[int]
    acted: Acted
    kept: Kept
    say: Callable[[str], None]
    spec: Mapping[str, Any]
    origin: Origin = field(init=False)

    def __post_init__(self) -> None:
        self.origin = Origin.of(self.bench.material.dataset)

    def check(self) -> None:
        """Raises: DataError unless nothing is there, or what the same judgement left before."""
        check_replaceable(self.path)
        if not self.path.exists():
            return
        try:
            there, wanted = open_dataset(self.path), self._header()
            last = there.lineage[-1] if there.lineage else {}
            if (there.spec, [last]) == (wanted.spec, wanted.lineage):
                return
            found = f"made by {last.get('verb', 'collect or import')}"
            if last.get("verb") == VERB:
                found = "episodes of another policy, of other data or tasks, or of other settings"
        except FormatError as error:
            found = error.what
        raise DataError("something else is there", where=str(self.path), found=found,
                        hint="choose another --keep, or move it away first")  # fmt: skip

    def write(self) -> None:
        """The file of the episodes that were run. Raises: as `write_file`."""
        episodes = sorted(self.kept.episodes, key=lambda e: (e.task, e.seed_key[4]))
        write_file(
            self.path, self._header(),
            EpisodeSource(episodes, len(episodes), sum(e.length for e in episodes)),
            finish=standard_additions,
        )  # fmt: skip
        self.say(f"kept {len(episodes):,} episodes: {self.path}")

    def _header(self) -> FileHeader:
        bench, tasks = self.bench, [self.origin.tasks[row] for row in sorted(self.rows)]
        levels = {}
        for task in tasks:
            own = [e.episode_return for e in self.kept.episodes if e.task == task.index]
            same = bench.horizon == bench.material.horizon
            known = own and same  # of episodes that are yet to be run nothing is
            levels[task.index] = level_on(task, float(np.mean(own))) if known else math.nan
        return header_of_policy(self.origin, self.acted, VERB, tasks, levels, **self.spec)
