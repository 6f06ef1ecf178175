"""`mpdt-train rollout`: a bundle acts on some of its tasks, and its episodes are a data file."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path

import msgspec
import torch

from mpdt.data.collect.collect import Progress as Collecting
from mpdt.data.collect.origin import Acted, Origin
from mpdt.data.collect.rollouts import RolledOut, RollOuts, roll_out_to
from mpdt.data.reference import Reference, References
from mpdt.data.spec.tasks import Family
from mpdt.data.store.tables import TaskRow
from mpdt.errors import UsageError, unknown_name
from mpdt.train.bundle.format import OWN, BundleConfig, TaskFacts, seal
from mpdt.train.bundle.read import read_bundle
from mpdt.train.bundle.select import NOT_ADAPTED, policy_of_bundle, refuse_left_out
from mpdt.train.rollout.ladder import BundleLadder
from mpdt.train.run.progress import Progress

MOST_NOISE = 100.0
ROLES = {"train": ("train", "both"), "test": ("test", "both"), "all": ("train", "test", "both")}


def plan_roll_outs(
    folder: Path, tasks: str, start: str | None, episodes: int, noise: float, series: int
) -> RollOuts:
    """What a bundle's roll-outs are, found out before anything is made.

    Args:
        tasks: `train`, `test`, `all`, or names with commas.
        start: set of prompts; None = own, or none where a task has no own.
        noise: standard deviation added to actions.
        series: number of the roll-outs; each begins elsewhere.
    Raises: as `read_bundle`; UsageError for tasks without prompts there or numbers out of range.
    """
    if not (math.isfinite(noise) and 0 <= noise <= MOST_NOISE):
        raise UsageError("out of range", where="--noise", expected=f"0 to {MOST_NOISE:g}",
                         found=f"{noise:g}")  # fmt: skip
    bundle = read_bundle(folder)
    config, family = bundle.config, bundle.family
    origin = origin_of(config, family)
    names = _chosen(config, tasks)
    start = _start(config, names, start)
    policy = policy_of_bundle(bundle, names[0], start)
    acted = Acted(
        f"{config.name} {start}" + (f" + noise {noise:g}" if noise else ""),
        _with_noise(policy.fingerprint, noise),
        {"bundle": seal(msgspec.to_builtins(config)), "start": start, "noise": float(noise)},
    )
    rows = tuple(row for row in origin.tasks if row.name in names)
    return RollOuts(
        origin, acted, BundleLadder(folder, policy.fingerprint, start, float(noise), acted), rows,
        episodes, series, tasks == "test" and "goals" in origin.spec and bool(origin.spec["goals"]),
    )  # fmt: skip


def origin_of(config: BundleConfig, family: Family) -> Origin:
    """The data of a bundle, as the bundle knows it."""
    data = config.data
    rows = [
        TaskRow(one.name, family.task(one.name).index, one.role, {}, _references(one))
        for one in config.tasks
    ]
    return Origin(
        family.name, data.name, data.version, data.license, data.content_hash, data.spec,
        tuple(sorted(rows, key=lambda row: row.index)), family.has_success,
    )  # fmt: skip


def roll_out(
    asked: RollOuts, target: Path, workers: int | None, restart: bool, progress: Progress
) -> RolledOut:
    """Make the file.

    Raises: as `roll_out_to`; Stopped after a signal, with finished blocks kept.
    """

    def tell(now: Collecting) -> None:
        if now.last is None and now.resumed_blocks:
            progress.say(f"resuming: {now.resumed_blocks} of {now.num_blocks} blocks done")
        label = now.last.label if now.last else ""
        progress.update("roll-outs", now.done_steps, now.num_steps, label)

    with _one_thread():
        return roll_out_to(
            asked, target, workers=workers, restart=restart,
            versions={"torch": version("torch")}, on_progress=tell,
        )  # fmt: skip


@contextmanager
def _one_thread() -> Iterator[None]:
    """As in every worker: threads may change last bits, and a robot amplifies them."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _chosen(config: BundleConfig, tasks: str) -> list[str]:
    known = [task.name for task in config.tasks]
    if tasks in ROLES:
        found = [task.name for task in config.tasks if task.role in ROLES[tasks]]
        if not found:
            raise UsageError(f"no {tasks} task", where=config.name, hint="--tasks all")
        return found
    names = [name for word in tasks.split(",") if (name := word.strip())]
    for name in names:
        if name not in known:
            raise unknown_name("task", name, [*known, *ROLES], where="--tasks")
    if not names:
        raise UsageError("no task named", where="--tasks", expected="train, test, all or names")
    return [name for name in known if name in names]


def _start(config: BundleConfig, names: Sequence[str], start: str | None) -> str:
    """The set of prompts that all the tasks have."""
    sets = {one.name: one.tasks for one in config.prompts}
    refuse_left_out(config, start)
    if start is not None and start not in sets:
        raise unknown_name("start", start, sets, where=config.name)
    for each in [OWN, NOT_ADAPTED] if start is None else [start]:
        if set(names) <= set(sets.get(each, ())):
            return each
    asked = OWN if start is None else start
    missing = [name for name in names if name not in sets.get(asked, ())]
    raise UsageError(
        f"no prompts of the set {asked}", where=", ".join(missing[:3]),
        expected="one set of prompts for all tasks of a file",
        hint="roll out --tasks train and --tasks test apart, or name another --start: "
        + ", ".join(sets),
    )  # fmt: skip


def _references(task: TaskFacts) -> References:
    known = {
        name: Reference(one.mean, math.nan if one.error is None else one.error, one.episodes,
                        one.success, one.source)
        for name, one in task.references.items()
    }  # fmt: skip
    return References(known, task.constant_action)


def _with_noise(fingerprint: bytes, noise: float) -> bytes:
    if not noise:
        return fingerprint
    return hashlib.sha256(fingerprint + f"noise {float(noise)!r}".encode()).digest()
