"""`mpdt-train evaluate --policy`: somebody's policy on the tasks of a file, beside the rows that
every table has. Reads names, options and references of the file, no episode of it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mpdt.data.sim.actors import Actions, Observations, Rewards, Rows
from mpdt.data.slices.several import open_ref
from mpdt.errors import DataError, UsageError, quoted
from mpdt.train.adapt.trials.protocol import spoken
from mpdt.train.bundle.acting import ActingPolicy
from mpdt.train.bundle.build import Bundle
from mpdt.train.bundle.format import OWN, BundleConfig, FamilyFacts
from mpdt.train.bundle.read import is_bundle, read_bundle
from mpdt.train.bundle.select import NOT_ADAPTED
from mpdt.train.evaluate.rollout import Evaluation, EvaluationSettings
from mpdt.train.evaluate.score import REFERENCES, Block, Reads, Score, encode_results, with_verdicts
from mpdt.train.fit.data import ALL, Material
from mpdt.train.run.bench import Bench
from mpdt.train.run.keep import Keeper, KeptRow
from mpdt.train.run.load import local_folder
from mpdt.train.run.outside import Named, OutsideActor, importing_from, load_callable
from mpdt.train.run.prepare import check_sizes
from mpdt.train.run.progress import Progress
from mpdt.train.run.results import VERSIONED
from mpdt.version import installed

MOST_SHIFT = 10.0
"""Standard deviations that a column's mean may lie from what a bundle was trained on."""


def judge_outside(
    policy: str, ref: str, settings: EvaluationSettings, progress: Progress, keep: Path | None,
    reads: Reads | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Results of a policy on the tasks of a file, as `results.json` has them.

    Args:
        policy: `module:function`, or where a bundle lies.
        ref: the data file.
        keep: where episodes go.
        reads: what a function has read of a test task before its first step; a bundle says itself.
    Raises: UsageError, ShapeError and DataError for what the policy does; as `open_dataset`,
        `read_bundle`, `check_fits`; Stopped after a signal.
    """
    told: dict[str, Any] = {}
    check_sizes({"evaluation": msgspec.to_builtins(settings)})
    material = _material(ref)
    bench = Bench(material, settings, progress)
    folder = local_folder(policy) if "://" in policy else Path(policy)
    if is_bundle(folder) or is_bundle(folder / "policy"):
        folder = folder if is_bundle(folder) else folder / "policy"
        if reads is not None:
            raise UsageError("a bundle says itself what was read for each of its prompts",
                             where="--reads", hint="leave it out")  # fmt: skip
        bundle = read_bundle(folder)
        for line in check_fits(bundle.config, material):
            progress.say(line)
        name = bundle.config.name
        scores = _judged(bench, _BundleRows(bundle, bench, progress, keep))
    else:
        named = load_callable(policy)
        name = named.words
        with importing_from(Path.cwd()):  # it may import more when it is called
            scores = _judged(bench, _CallableRows(named, bench, progress, keep, reads))
        told = {"policy": {"name": name, "fingerprint": named.fingerprint.hex()}}
    dataset = material.dataset
    header = {
        "name": name,
        **told,
        "data": {"file": dataset.title, "name": dataset.name, "version": dataset.version,
                 "content_hash": dataset.content_hash, "horizon": bench.horizon},
        "versions": installed(VERSIONED),
        "evaluation": msgspec.to_builtins(settings),
    }  # fmt: skip
    results: dict[str, Any] = json.loads(encode_results(header, scores))
    return results


def check_fits(config: BundleConfig, material: Material) -> list[str]:
    """What to know before a bundle acts on another file than its own.

    Raises: UsageError for other spaces; DataError for observations that the policy never saw.
    """
    ours, theirs = FamilyFacts.of(material.family), config.family
    asked = msgspec.structs.replace(theirs, name=ours.name)
    if asked != ours:
        name, there, here = next(
            (field, getattr(asked, field), getattr(ours, field))
            for field in ours.__struct_fields__
            if getattr(asked, field) != getattr(ours, field)
        )
        raise UsageError(
            f"this policy is of {theirs.name} and cannot act in {ours.name}: other {name}",
            where=str(material.dataset.path), expected=str(there), found=str(here),
            hint=f"judge it on a file of {theirs.name}",
        )  # fmt: skip
    lines = []
    if theirs.name != ours.name:
        lines.append(f"of another family: {theirs.name} acts in {ours.name}")
    if config.data.content_hash == material.dataset.content_hash:
        return lines
    stats = material.dataset.stats.get("observations")
    if stats is None:
        return [*lines, "this file has no statistics to compare with those of the policy"]
    mean, std = np.array(config.statistics.mean), np.array(config.statistics.std)
    shift = np.abs(stats["mean"] - mean) / np.maximum(std, 1e-6)
    worst = int(shift.argmax())
    column = material.family.columns[worst]
    sides = f"{mean[worst]:.3g} +- {std[worst]:.3g}", f"{stats['mean'][worst]:.3g}"
    if not shift[worst] <= MOST_SHIFT:
        raise DataError(
            f"observations that the policy never saw: {column}",
            where=str(material.dataset.path),
            expected=f"mean within {MOST_SHIFT:g} standard deviations of {sides[0]}",
            found=sides[1],
            hint="train on this file: mpdt-train --data, with --from to begin where the policy is",
        )
    return [*lines, f"statistics of the observations: means within {shift[worst]:.2g} standard "
            f"deviations of the policy's, most in {column}"]  # fmt: skip


@dataclass
class _CallableRows:
    """One row of the table: a callable, task by task."""

    named: Named
    bench: Bench
    progress: Progress
    keep: Path | None
    reads: Reads | None

    def __post_init__(self) -> None:
        self.keeper = _keeper(self, self.named.words, {"policy": self.named.words}, single=True)

    def of(self, block: Block, rows: Sequence[int]) -> Iterator[list[Score]]:
        bench, named, material = self.bench, self.named, self.bench.material
        reads = self.reads if block == "test" else None
        name = "policy" if material.one_table else block
        with _kept(
            self.keeper, bench, block, rows, name, named.words, named.fingerprint, reads
        ) as row:
            found = [
                bench.run(block, f"{block}: {named.words}", [one],
                          OutsideActor(named, material.dataset.tasks.names[one], material.family),
                          row.kept if row else None)
                for one in rows
            ]  # fmt: skip
            if row:
                row.write()
        yield bench.scores_of(block, named.words, rows, _joined(found), reads)


@dataclass
class _BundleRows:
    """A row for every set of prompts that has the tasks."""

    bundle: Bundle
    bench: Bench
    progress: Progress
    keep: Path | None

    def __post_init__(self) -> None:
        self.keeper = _keeper(self, self.bundle.config.name, {"data": self._data()}, single=False)

    def _data(self) -> str:
        return self.bundle.config.data.content_hash

    def of(self, block: Block, rows: Sequence[int]) -> Iterator[list[Score]]:
        config, names = self.bundle.config, self.bench.material.dataset.tasks.names
        tasks = [names[row] for row in rows]
        sets = [one for one in config.prompts if set(tasks) <= set(one.tasks)
                and (one.name == OWN) == (block == "train")]  # fmt: skip
        for one in sets:
            yield self._scores(block, rows, one.name, tasks, one.reads, one.name)
        if not sets:
            stand_in = next((p for p in config.prompts if p.name == NOT_ADAPTED), None)
            if stand_in is None:
                raise UsageError("no prompts for these tasks", where=config.name,
                                 expected=", ".join(tasks[:5]),
                                 found=", ".join(one.name for one in config.prompts))  # fmt: skip
            same = stand_in.tasks[:1] * len(tasks)
            name = f"{NOT_ADAPTED}-{block}"
            yield self._scores(block, rows, NOT_ADAPTED, same, "nothing", name)

    def _scores(
        self, block: Block, rows: Sequence[int], start: str, tasks: Sequence[str],
        reads: Reads | None, name: str,
    ) -> list[Score]:  # fmt: skip
        bundle, bench = self.bundle, self.bench
        chosen = next(one for one in bundle.config.prompts if one.name == start)
        policy = ActingPolicy(
            bundle.policy, bundle.prompts[start], bundle.returns(start), bundle.family,
            chosen.tasks, tasks[0], bundle.config.window,
        )  # fmt: skip
        method = f"{bundle.config.name} {spoken(start)}"
        actor = _BundleActor(policy, tasks)
        with _kept(self.keeper, bench, block, rows, name, method, policy.fingerprint, reads) as row:
            scores = bench.score(block, method, rows, actor, reads, row.kept if row else None)
            if row:
                row.write()
        return scores


class _BundleActor:
    """A loaded policy; every row says which of the tasks it is."""

    def __init__(self, policy: ActingPolicy, tasks: Sequence[str]) -> None:
        self._policy, self._tasks = policy, tasks

    def begin(self, rows: Rows) -> None:
        self._policy.reset([self._tasks[task] for task in rows.tasks.tolist()])

    def act(self, step: int, observations: Observations, rewards: Rewards | None = None) -> Actions:
        return self._policy.act_batch(observations, rewards)


def _judged(bench: Bench, subject: _CallableRows | _BundleRows) -> list[Score]:
    """References and rows, block by block; what would be the same episodes is run once."""
    material, settings = bench.material, bench.settings
    scores: list[Score] = []
    blocks: list[tuple[Block, Sequence[int]]] = [
        ("train", material.train_rows), ("test", material.test_rows)
    ]  # fmt: skip
    for block, rows in blocks:
        if not rows or block not in settings.blocks:
            continue
        again = block == "test" and bool(scores) and material.one_table
        if again and settings.train_episodes in (0, settings.episodes):
            if isinstance(subject, _CallableRows):
                continue  # the same episodes of the same tasks
            old = [one for one in scores if one.method in REFERENCES]
            scores += [msgspec.structs.replace(one, block="test") for one in old]
        else:
            scores += bench.references(block, rows)
        for found in subject.of(block, rows):
            scores += found
    return with_verdicts(scores)


def _keeper(
    subject: _CallableRows | _BundleRows, name: str, facts: dict[str, Any], single: bool
) -> Keeper | None:
    if subject.keep is None:
        return None
    material = subject.bench.material
    both = bool(material.train_rows and material.test_rows) and not material.one_table
    single = single and not (both and len(subject.bench.settings.blocks) > 1)
    return Keeper(subject.keep, name, facts, subject.progress.say, single)


def _kept(
    keeper: Keeper | None, bench: Bench, block: Block, rows: Sequence[int], name: str, method: str,
    fingerprint: bytes, reads: Reads | None,
) -> AbstractContextManager[KeptRow | None]:  # fmt: skip
    """The row's file, if episodes are kept."""
    if keeper is None:
        return nullcontext()
    return keeper.row(bench, name, method, fingerprint, rows, bench.episodes(block), reads)


def _joined(found: Sequence[Evaluation]) -> Evaluation:
    successes = [one.successes for one in found if one.successes is not None]
    return Evaluation(
        tuple(name for one in found for name in one.tasks),
        np.concatenate([one.returns for one in found]),
        np.concatenate([one.lengths for one in found]),
        np.concatenate(successes) if successes else None,
    )


def _material(ref: str) -> Material:
    """A file as far as judging needs it: no episode has to be in it.

    Raises: as `open_dataset`; UsageError for a slice or an unknown family.
    """
    dataset, slice_name = open_ref(ref)
    if slice_name is not None:
        raise UsageError("a slice chooses episodes, and none is read here", where=ref,
                         hint=f"--data {quoted(dataset.path)}")  # fmt: skip
    return Material(
        dataset=dataset, slice=None, quality=ALL, family=dataset.contract(),
        train_rows=tuple(dataset.tasks.train_rows), test_rows=tuple(dataset.tasks.test_rows),
        episode_ids={},
    )  # fmt: skip
