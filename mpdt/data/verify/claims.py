"""claims: what a reader believes beside the episodes is what can be found out again.

    entry points, roles, licence   from the entry of datasets.yaml that the file carries
    statistics, slices             from the steps and the columns, by the rules they name
    policies                       from the ladder of the entry, for those whose hash is known here
    references                     what mpdt ships, and what the stored episodes return

A program that changes one of them and seals the file anew is found here. What cannot be found out
again (references that were measured in a collection, rates of one's own) is counted, and with
--locked compared with the lock.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

import msgspec
import numpy as np

from mpdt.data.collect.job import Job, make_job
from mpdt.data.collect.pack import tta_source
from mpdt.data.collect.standing import standing_spec
from mpdt.data.lock.file import LockEntry
from mpdt.data.lock.fingerprint import table_hashes
from mpdt.data.reference import Reference
from mpdt.data.sim.constants import constant_actions
from mpdt.data.slices.cut import Cut, choose
from mpdt.data.slices.standard import standard_slices
from mpdt.data.slices.stats import compute_stats
from mpdt.data.spec.entry import DatasetSpec, own_weights
from mpdt.data.spec.env import describe_env
from mpdt.data.store import provenance
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.layout import ROLE_CODES
from mpdt.data.store.licence import combined
from mpdt.data.store.origin import damaged_hint
from mpdt.data.verify.finding import Fault, Finding, fault, judge
from mpdt.data.verify.material import Material
from mpdt.errors import MpdtError

ID = "claims"
TOLERANCE = 1e-9
"""Of a statistic, relative to its column's spread: sums end in other bits on other processors."""


def check_claims(material: Material, lock: tuple[str, LockEntry | None] | None) -> Finding:
    """Args:
    lock: the lock file's words for messages and its entry; None = the lock is not asked.
    """
    data = material.dataset
    faults = [
        *_env_faults(data),
        *_spec_faults(material),
        *_stats_faults(data),
        *_slice_faults(data),
    ]
    faults += _origin_faults(data)
    job = _job(data)
    unproven = 0
    if job is not None:
        faults += _policy_faults(data, job)
        faults += _set_faults(data, job)
        references = _References(data, job)
        faults += references.faults()
        unproven = references.unproven
    locked = ""
    if lock is not None and lock[1] is not None:
        faults += _lock_faults(data, lock[0], lock[1])
        locked = ", as locked" if lock[1].tables else "; the lock of an older release says less"
    text = f"roles, statistics, {len(data.slices)} slices"
    text += ", policies and references found again" if job is not None else (
        " found again; policies and references cannot be: their ladder is not here" + locked
    )  # fmt: skip
    if unproven and lock is not None and lock[1] is not None and not lock[1].tables:
        faults.append(Fault(f"{unproven} references are as the file says: {lock[0]}, the lock of "
                            "an older release says less", is_doubt=True))  # fmt: skip
    if unproven:
        text += f"; {unproven} references were measured when it was collected{locked}"
    is_wrong = any(not one.is_doubt for one in faults)
    return judge(ID, faults, text, damaged_hint(material.path, data) if is_wrong else "")


def _env_faults(data: Dataset) -> Iterator[Fault]:
    """An entry point is code that runs when somebody recovers the environment."""
    for name, env in zip(data.tasks.names, data.tasks.envs, strict=True):
        wanted = describe_env(data.spec, data.family, name, data.definition)
        if wanted and env not in ({}, wanted):
            yield Fault(f"task {name}: not our entry point: {str(dict(env))[:80]}")


def _spec_faults(material: Material) -> Iterator[Fault]:
    data, roles = material.dataset, _roles(material)
    codes = {code: role for role, code in ROLE_CODES.items()}
    for name, code in zip(data.tasks.names, data.tasks.roles.tolist(), strict=True):
        if name in roles and codes[code] != roles[name]:
            yield Fault(f"task {name} has role {codes[code]}, its entry says {roles[name]}")
    said = data.spec.get("license")
    if isinstance(said, str) and data.license not in (said, combined([said])):
        yield Fault(f"licence {data.license}, its entry says {said}")
    for key in ("family", "name", "version"):
        if key in data.spec and data.spec[key] != getattr(data, key):
            yield Fault(f"{key} {getattr(data, key)}, its entry says {data.spec[key]}")


def _origin_faults(data: Dataset) -> Iterator[Fault]:
    if data.episodes.source is not None and not data.parent:
        yield Fault("episodes have ids of a source, but no source is named")
    if data.parent and not data.lineage:
        yield Fault("cut out of another file, and no step says how", is_doubt=True)


def _set_faults(data: Dataset, job: Job) -> Iterator[Fault]:
    """Sets that the entry asks for are by its rule, and ask for its returns.

    A doubt only: `tta --overwrite` may have made another one. The lock knows which it was.
    """
    for name, tta in data.tta.items():
        if name not in job.spec.tta:
            continue  # added later
        source = tta_source(job.plan, name, (), 0, 0)
        wanted = dict(source.rule)
        if "seed" in tta.rule:  # an import says it with the set
            wanted["seed"] = job.spec.seed
        if dict(tta.rule) != wanted:
            yield Fault(f"its rule {dict(tta.rule)} is not that of the entry", track=f"tta {name}",
                        is_doubt=True)  # fmt: skip
        asked = np.array([
            source.preset_returns.get(data.tasks.indices[row], np.nan) for row in tta.task
        ], np.float32)  # fmt: skip
        if len(wrong := np.flatnonzero(asked != tta.preset_return)):
            yield fault("asks for another return than its entry", wrong, f"tta {name}", doubt=True)


def _roles(material: Material) -> dict[str, str]:
    """By task name; of an import those of the family."""
    spec = _spec(material.dataset)
    if spec is not None:
        return {task.name: task.role for task in spec.resolve_tasks()}
    family = material.family
    return {task.name: task.role for task in family.tasks} if family else {}


def _spec(data: Dataset) -> DatasetSpec | None:
    """The entry, where the file was collected."""
    try:
        return msgspec.convert(dict(data.spec), DatasetSpec)
    except (msgspec.ValidationError, MpdtError):
        return None


def _imported(data: Dataset) -> DatasetSpec | None:
    """The entry under which an import got its references."""
    try:
        return standing_spec(data) if "import" in data.spec else None
    except MpdtError:
        return None


def _job(data: Dataset) -> Job | None:
    """What collecting the entry would do here; None where its ladder is not here.

    A file decides nothing that is read beside it: weights that it names by a path are not opened.
    """
    spec = _spec(data) or _imported(data)
    if spec is None or own_weights(spec.behaviour):
        return None
    try:
        return make_job(spec)
    except MpdtError:
        return None


def _stats_faults(data: Dataset) -> Iterator[Fault]:
    stored = data.stats_info
    if stored is None or not np.isin(data.episodes.task, stored.tasks_seen).any():
        return  # a cut-out without training episodes keeps the statistics of its source
    found = compute_stats(data, stored.slice)
    if found.tasks_seen != stored.tasks_seen:
        yield Fault("statistics are of other tasks than those with training episodes")
        return
    for field, table in found.fields.items():
        spread = np.maximum(table["max"] - table["min"], np.abs(table["max"])) + 1e-30
        for name, values in table.items():
            away = np.abs(stored.fields[field][name] - values)
            if not (away <= TOLERANCE * spread).all():  # also for NaN
                column = int(np.flatnonzero(~(away <= TOLERANCE * spread))[0])
                yield Fault(f"statistics: {name} of {field} column {column} is "
                            f"{stored.fields[field][name][column]:g}, the steps give "
                            f"{values[column]:g}")  # fmt: skip
                break
    constant = {field: tuple(columns) for field, columns in stored.constant.items()}
    if constant != dict(found.constant):
        yield Fault("statistics: other columns are constant")


def _slice_faults(data: Dataset) -> Iterator[Fault]:
    standard = standard_slices(data)
    keys = {one.name for one in fields(Cut)}
    for name, ids in data.slices.items():
        rule = dict(data.slice_rules[name])
        if name in standard and rule == dict(standard[name].rule):
            wanted = standard[name].ids
        elif rule and set(rule) <= keys and rule.get("slice") != name:
            wanted = _chosen(data, rule)
        else:
            continue  # made by a program, by a rule of its own
        if wanted is None or not np.array_equal(wanted, ids):
            yield fault(f"slice {name} is not what its rule {rule} chooses", ids)


def _chosen(data: Dataset, rule: Mapping[str, Any]) -> Any:
    """Episodes of the rule of a `split --name`; None where it chooses nothing."""
    values: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in rule.items()
    }
    try:
        return choose(data, Cut(**values))
    except (MpdtError, TypeError, ValueError):
        return None


def _policy_faults(data: Dataset, job: Job) -> Iterator[Fault]:
    """Rows whose hash the entry's ladder has: everything else of them follows from it."""
    known = {(one.task, one.hash): one for one in job.policies}
    for row in data.policy_infos():
        wanted = known.get((row.task, row.hash))
        if wanted is None:
            continue  # weights or rates of another release or of one's own
        for key in ("rung", "level", "train_step", "mix_rate", "name"):
            stored, right = getattr(row, key), getattr(wanted, key)
            same = stored == right or (isinstance(right, float) and np.float32(right) == stored)
            if not same and not (stored != stored and right != right):
                yield Fault(f"policy {row.name}: {key} {stored}, its ladder says {right}")


@dataclass
class _References:
    """References against the record and the stored episodes.

    unproven: how many could not be found out again.
    """

    data: Dataset
    job: Job
    unproven: int = 0

    def faults(self) -> list[Fault]:
        data, found = self.data, list[Fault]()
        # Another release ships other numbers, and the file keeps those of its own.
        doubt = data.packages.get("mpdt") != provenance.packages().get("mpdt")
        tasks = {task.name: task for task in self.job.plan.tasks}
        for row, name in enumerate(data.tasks.names):
            if name not in tasks:
                continue
            record = self.job.plan.on_record(tasks[name])
            references = data.tasks.references[row]
            for kind, stored in references.by_name.items():
                wanted = record.by_name.get(kind)
                if kind == "constant" and stored.source != "local" and record.constants:
                    wanted = self._constant(references.constant_action, record.constants)
                    if wanted is None:
                        found.append(Fault(f"task {name}: no candidate for a constant action: "
                                           f"{references.constant_action}"))  # fmt: skip
                        continue
                elif stored.source == "collected":
                    wanted = self._collected(row, kind)
                if wanted is None or (stored.source == "local") != (wanted.source == "local"):
                    self.unproven += 1
                elif difference := _difference(stored, wanted):
                    found.append(Fault(f"task {name}: reference {kind} {difference}",
                                       is_doubt=doubt and kind != "collected"))  # fmt: skip
        return found

    def _constant(
        self, action: tuple[float, ...], candidates: tuple[Reference, ...]
    ) -> Reference | None:
        actions = constant_actions(len(action)).tolist() if action else []
        return candidates[actions.index(list(action))] if list(action) in actions else None

    def _collected(self, row: int, kind: str) -> Reference | None:
        """Of the file's own episodes, where it has all that were collected."""
        data = self.data
        if data.parent or kind not in ("random", "expert"):
            return None
        ids = data.select(task=row, quality=kind)
        return Reference.of(data.episodes.returns[ids]) if len(ids) else None


def _difference(stored: Reference, wanted: Reference) -> str:
    """In what they differ first; nothing where they are the same."""
    for key in ("mean", "error", "success", "episodes"):
        a, b = getattr(stored, key) or 0.0, getattr(wanted, key) or 0.0
        if not (a == b or a != a or abs(a - b) <= 1e-9 * max(abs(a), abs(b))):
            what = "" if key == "mean" else f"has {key} "
            return f"{what}{a:.6g} ({stored.source}), found again {b:.6g}"
    if stored.source not in ("", wanted.source):
        return f"is said to be {stored.source}, found again as {wanted.source}"
    return ""


def _lock_faults(data: Dataset, path: str, entry: LockEntry) -> Iterator[Fault]:
    found = table_hashes(data)
    for name, hash in entry.tables.items():
        if name in found and found[name] != hash:
            yield Fault(f"task {name}: references, policies or role are not those of {path}")
    said = entry.spec.get("license")
    if isinstance(said, str) and data.license != said:
        yield Fault(f"licence {data.license}, {path} says {said}")
