"""Card: one HTML page that tells what is in a dataset file, shows it, and says how to remake it."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mpdt.data.card import figures
from mpdt.data.card.facts import QUALITIES, Facts, TaskFacts, commands
from mpdt.data.card.film import Film
from mpdt.data.lock.file import LockEntry
from mpdt.data.lock.fingerprint import is_as_locked
from mpdt.data.reference import REFERENCE_POLICIES
from mpdt.data.spec.yamltext import dump_yaml
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.provenance import WEIGHTS
from mpdt.data.verify.finding import Finding, Outcome
from mpdt.data.verify.verify import Report, summary
from mpdt.draw.html import render
from mpdt.version import __version__

REFERENCE_NAMES = {
    "zero": "zero action", "random": "random", "constant": "best constant", "expert": "expert",
}  # fmt: skip
WORST = (Outcome.FAIL, Outcome.WARN, Outcome.SKIP, Outcome.PASS, Outcome.NONE)


def card_page(
    facts: Facts,
    lock: LockEntry | None,
    report: Report | None = None,
    films: Sequence[Film] = (),
    no_films: str = "",
) -> str:
    """The page as text.

    Args:
        lock: what datasets.lock holds under the file's name.
        report: findings of verify; None = not asked for.
        no_films: why there are none.
    """
    data = facts.data
    state, lock_told = _lock_state(data, lock)
    findings = report.findings if report else []
    lengths = np.concatenate(list(facts.lengths.values()))
    return render(
        "card.html", "mpdt.data.card",
        facts=facts,
        counts=[_count(len(facts.tasks), "task"), _count(len(facts.ids), "episode"),
                _count(facts.num_steps, "step")],
        told=_told(facts), megabytes=data.num_bytes / 1e6,
        lock=state, lock_told=lock_told, report=report, summary=summary(findings),
        worst=_worst(findings),
        keys=[(quality, quality) for quality in facts.qualities],
        task_blind_keys=[
            (name, words) for name, words in figures.TASK_BLIND.items()
            if any(task.references[name].is_known for task in facts.tasks)
        ],
        overviews=figures.overviews(facts), ladders=figures.ladders_chart(facts),
        films=[_film(data, film) for film in films], no_films=no_films,
        tasks=[_task(task) for task in facts.tasks],
        has_success=data.steps.successes is not None,
        lengths=figures.lengths_chart(facts), length=int(lengths[0]),
        actions=figures.action_charts(facts), sampled=figures.ACTION_EPISODES,
        also=_also(data), made=_made(data),
        typed="; mpdt-data verify ".join(
            shlex.quote(one.title) for one in data.parts or [data]
        ),
        commands=commands(data, facts.slice, _whole_is_locked(data, lock)),
        provenance=_provenance(data), entry=_entry(data), version=__version__,
    )  # fmt: skip


def _count(number: int, thing: str) -> str:
    return f"{number:,} {thing}" + "s" * (number != 1)


def _told(facts: Facts) -> str:
    data, family = facts.data, facts.family
    roles = [task.role for task in facts.tasks]
    split = ", ".join(
        f"{_count(roles.count(role), 'task')} {words}"
        for role, words in (("train", "to train on"), ("test", "to test on"),
                            ("both", "to train and test on"))
        if role in roles
    )  # fmt: skip
    sizes = f"{data.observation_size} numbers of observation, {data.action_size} of action"
    if family is None:
        return f"Family {data.family}: {split}; {sizes}."
    horizon = data.spec.get("horizon", family.horizon)
    goal = "hidden from the observation" if family.goal_hidden else "in the observation"
    return (
        f"{family.about or f'Family {family.name}'}: {split}. {sizes.capitalize()} within "
        f"[{family.action_low:g}, {family.action_high:g}]; at most {horizon} steps of "
        f"{family.step_s * 1000:g} ms; "
        f"the goal is {goal}."
    )


def _made(data: Dataset) -> str:
    spec = data.spec
    if "import" in spec:
        return "Imported; what was not in the source is unknown here too."
    behaviour = spec.get("behaviour")
    behaviour = behaviour if isinstance(behaviour, Mapping) else {}
    if behaviour.get("script"):
        who = (
            "The experts are Meta-World's scripts (some corrected); medium replaces a share of "
            "their actions by uniform ones, calibrated per task; history goes through all shares"
        )
    elif behaviour.get("bundle"):
        digest = data.packages.get(WEIGHTS, "unknown")[:16]
        who = (
            f"The experts are one policy of a training (SHA-256 {digest}), which acts behind a "
            "prompt per task; medium replaces a share of its "
            "actions by uniform ones, calibrated per task; history goes through all shares"
        )
    else:
        who = (
            f"The experts are networks trained with reinforcement learning (network "
            f"{behaviour.get('network', 'unknown')}, {behaviour.get('rungs', '?')} rungs kept on "
            "the way); medium is the rung of half the normalised return, history goes through all"
        )
    return f"{who}. Random actions are uniform. Root seed {spec.get('seed', 'unknown')}."


def _lock_state(data: Dataset, entry: LockEntry | None) -> tuple[str, str]:
    """A word and a sentence."""
    if data.parent:
        of = "the locked file" if _whole_is_locked(data, entry) else f"{data.parent[:12]}"
        return "cut-out", f"Cut out of {of}; cut-outs are not locked themselves."
    if entry is None:
        return "not locked", f"datasets.lock has no entry {data.name}."
    if is_as_locked(data, entry):
        return "as locked", f"It has the content that datasets.lock holds for {entry.version}."
    return "not as locked", (
        f"datasets.lock holds {data.name} {entry.version} with content "
        f"{entry.hashes.content[:12]}, which is not this."
    )


def _whole_is_locked(data: Dataset, entry: LockEntry | None) -> bool:
    """Whether the collection it is, or was cut out of, is the locked one."""
    whole = data.parent or data.content_hash
    return entry is not None and len(data.lineage) <= 1 and whole == entry.hashes.content


def _worst(findings: Sequence[Finding]) -> str:
    return next((o.value for o in WORST if any(f.outcome is o for f in findings)), "PASS")


@dataclass(frozen=True)
class _Row:
    """One policy on one task: a reference, or the stored episodes of a quality."""

    name: str
    mean: float
    error: float
    level: float
    success: float | None
    episodes: int
    is_reference: bool = False


def _task(task: TaskFacts) -> Mapping[str, Any]:
    rows = [
        _Row(REFERENCE_NAMES[name], found.mean, found.error, task.level(found.mean),
             found.success, found.episodes, is_reference=True)
        for name in REFERENCE_POLICIES
        for found in [task.references[name]]
    ]  # fmt: skip
    rows += [
        _Row(quality, group.mean, group.error, task.level(group.mean), group.success,
             len(group.ids))
        for quality, group in task.groups.items()
    ]  # fmt: skip
    expert = task.groups.get("expert")
    return {
        "name": task.name, "role": task.role, "rows": rows,
        "success": expert.success if expert else None,
        "returns": figures.returns_chart(task), "ladder": figures.ladder_chart(task),
    }  # fmt: skip


def _film(data: Dataset, film: Film) -> Mapping[str, Any]:
    episode, columns = data.episode(film.episode), data.episodes
    names = {code: name for name, code in QUALITIES.items()}
    so_far = np.r_[0.0, np.cumsum(episode.rewards, dtype=np.float64)]
    has_success = data.steps.successes is not None
    return {
        "task": data.tasks.names[int(columns.task[film.episode])],
        "quality": names[episode.quality], "episode": film.episode, "length": episode.length,
        "total": float(so_far[-1]), "is_equal": film.is_equal,
        "success": bool(columns.success[film.episode]) if has_success else None,
        "frames": [
            {"pixels": pixels, "step": step, "so_far": float(so_far[step])}
            for pixels, step in zip(film.frames, film.steps, strict=True)
        ],
    }  # fmt: skip


def _also(data: Dataset) -> list[tuple[str, str]]:
    found = [(name, f"slice, {len(ids):,} episodes") for name, ids in data.slices.items()]
    for name, tta in data.tta.items():
        tasks = len(np.unique(tta.task))
        told = f"{_count(len(tta), 'unlabelled random-action episode')} of {_count(tasks, 'task')}"
        found.append((f"tta/{name}", f"{told}, for adaptation at test time"))
    return found


def _provenance(data: Dataset) -> list[tuple[str, str]]:
    return [
        ("content hash", data.content_hash),
        ("spec hash", data.spec_hash),
        *([("cut out of", data.parent)] if data.parent else []),
        ("made with", "  ".join(f"{name} {v}" for name, v in data.packages.items())),
        ("made on", "  ".join(f"{name} {v}" for name, v in data.platform.items())),
    ]


def _entry(data: Dataset) -> str:
    """The spec as a datasets.yaml of its own."""
    if not data.spec or "import" in data.spec:
        return ""
    entry = {key: value for key, value in data.spec.items() if key != "name"}
    return dump_yaml({"schema": 1, "datasets": {data.name: entry}})
