"""What a dataset file says about itself, as JSON values and as text tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.reference import REFERENCE_POLICIES, Reference, level
from mpdt.data.spec.entry import is_own_network
from mpdt.data.store import layout, provenance
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.tables import Int64
from mpdt.data.verbs.options import number, or_none, text_table

ROLES = {code: role for role, code in layout.ROLE_CODES.items()}


def describe(data: Dataset, ids: Int64 | None = None) -> dict[str, Any]:
    """Header, tasks, slices and TTA sets of a file as JSON values."""
    ids = np.arange(data.num_episodes) if ids is None else ids
    return {
        "path": str(data.path),
        "family": data.family,
        "name": data.name,
        "version": data.version,
        "content_hash": data.content_hash,
        "spec_hash": data.spec_hash,
        "parent": data.parent,
        "lineage": [dict(step) for step in data.lineage],
        "license": data.license,
        "episodes": len(ids),
        "steps": int(data.episodes.length[ids].sum()),
        "bytes": data.num_bytes,
        "observation_size": data.observation_size,
        "action_size": data.action_size,
        "packages": dict(data.packages),
        "own_weights": _own_weights(data),
        "tasks": [_task(data, row, ids) for row in range(len(data.tasks))],
        "slices": {name: len(found) for name, found in data.slices.items()},
        "tta": {name: len(tta) for name, tta in data.tta.items()},
    } | ({"files": [_file(part) for part in data.parts]} if data.parts else {})


def _file(data: Dataset) -> dict[str, Any]:
    return {
        "path": str(data.path),
        "name": data.name,
        "version": data.version,
        "content_hash": data.content_hash,
        "episodes": data.num_episodes,
    }


def _own_weights(data: Dataset) -> dict[str, str] | None:
    """Where the spec found weights that mpdt does not ship, and their SHA-256; else None."""
    behaviour = data.spec.get("behaviour")
    told = behaviour if isinstance(behaviour, Mapping) else {}
    digest = data.packages.get(provenance.WEIGHTS, "unknown")
    if isinstance(bundle := told.get("bundle"), str):
        return {"bundle": bundle, "sha256": digest}
    network = told.get("network")
    if not isinstance(network, str) or not is_own_network(network):
        return None
    return {"network": network, "sha256": digest}


def _task(data: Dataset, row: int, ids: Int64) -> dict[str, Any]:
    mine = ids[data.episodes.task[ids] == row]
    returns = {}
    for quality in QUALITY_CODES:
        of = mine[data.episodes.quality[mine] == QUALITY_CODES[quality]]
        if len(of):
            returns[quality] = float(data.episodes.returns[of].mean())
    tasks = data.tasks
    has_success = data.steps.successes is not None and len(mine) > 0
    return {
        "name": tasks.names[row],
        "role": ROLES[int(tasks.roles[row])],
        "episodes": len(mine),
        "returns": returns,
        "success": float(data.episodes.success[mine].mean()) if has_success else None,
        "references": {
            name: _reference(tasks.references[row][name])
            for name in REFERENCE_POLICIES
            if tasks.references[row][name].is_known
        },
        "constant_action": list(tasks.references[row].constant_action) or None,
    }


def _reference(found: Reference) -> dict[str, Any]:
    return asdict(found) | {"error": or_none(found.error)}


def level_table(
    data: Dataset, ids: Int64 | None = None, names: tuple[str, ...] | None = None
) -> str:
    """Mean return of zero action and of each quality; level between the references of medium, or
    of policy where roll-outs are all there is to ask about and their level is on record: it is not
    where they are of another length than the references are."""
    tasks = describe(data, ids)["tasks"]
    policies = data.policies
    known = {data.tasks.names[row] for row, reached in
             zip(policies.tasks, policies.levels, strict=True) if np.isfinite(reached)}  # fmt: skip
    present = {quality for task in tasks for quality in task["returns"]}
    shown = [name for name in QUALITY_CODES if name != "policy" or name in present]
    asked = "medium" if "medium" in present or "policy" not in present else "policy"
    heading = ("task", "role", "episodes", "zero", *shown, "level", "success")
    rows = []
    for task in tasks:
        if names is not None and task["name"] not in names:
            continue
        returns: Mapping[str, float] = task["returns"]
        found = [returns.get(quality, float("nan")) for quality in shown]
        reached = level(
            returns.get(asked, float("nan")), _mean(task, "random"), _mean(task, "expert")
        )
        if asked == "policy" and task["name"] not in known:
            reached = float("nan")
        success = "-" if task["success"] is None else f"{task['success']:.2f}"
        rows.append(
            [task["name"], task["role"], f"{task['episodes']:,}", number(_mean(task, "zero")),
             *map(number, found), number(reached, 2), success]
        )  # fmt: skip
    return text_table([heading, *rows], numbers_from=2)


def _mean(task: Mapping[str, Any], name: str) -> float:
    return float(task["references"].get(name, {"mean": float("nan")})["mean"])


def reference_table(data: Dataset, names: tuple[str, ...] | None = None) -> str:
    """What the reference policies return on each task, with errors; empty if nothing is known.

    The largest error is given as a share of the span, expert - random.
    """
    chosen = [
        (name, references)
        for name, references in zip(data.tasks.names, data.tasks.references, strict=True)
        if (names is None or name in names) and references.by_name
    ]
    if not chosen:
        return ""
    heading = ("reference", *REFERENCE_POLICIES, "success", "episodes", "error", "source")
    rows = []
    for name, references in chosen:
        found = [references[policy] for policy in REFERENCE_POLICIES]
        known = [reference for reference in found if reference.is_known]
        span = references["expert"].mean - references["random"].mean
        worst = max(reference.error for reference in known) / span if span > 0 else float("nan")
        success = references["expert"].success
        rows.append(
            [name, *(_with_error(reference) for reference in found),
             "-" if success is None else f"{success:.2f}",
             f"{sum(reference.episodes for reference in known):,}",
             "-" if worst != worst else f"{worst:.1%}",
             ", ".join(dict.fromkeys(reference.source for reference in known if reference.source))]
        )  # fmt: skip
    actions = {references.constant_action for _, references in chosen}
    line = "constant action  none chosen"
    if len(actions) == 1 and (action := actions.pop()):
        line = "constant action  " + " ".join(f"{number:g}" for number in action)
    return f"{text_table([heading, *rows], numbers_from=1)}\n{line}"


def _with_error(found: Reference) -> str:
    return f"{number(found.mean)} +- {number(found.error)}" if found.is_known else "-"


def header_lines(found: Mapping[str, Any]) -> list[str]:
    """The header of `describe` as lines."""
    origin = f"   cut out of {found['parent'][:8]}" if found["parent"] else ""
    versions = "  ".join(
        f"{name} {version}" for name, version in found["packages"].items()
        if name != provenance.WEIGHTS
    )  # fmt: skip
    own = found["own_weights"]
    return [
        f"{found['path']}   {found['name']} {found['version']}   family {found['family']}   "
        f"{found['bytes'] / 1e6:.1f} MB   {found['license']}",
        f"content  {found['content_hash']}{origin}",
        *(
            f"file     {file['path']}   {file['name']} {file['version']}   content "
            f"{file['content_hash'][:8]}   {file['episodes']:,} episodes"
            for file in found.get("files", ())
        ),
        *(f"lineage  {_step_text(step)}" for step in found["lineage"]),
        f"size     {found['episodes']:,} episodes   {found['steps']:,} steps   "
        f"observation {found['observation_size']}   action {found['action_size']}",
        f"made by  {versions}",
        *(
            [
                f"weights  not of mpdt: {own.get('network') or own['bundle']}   "
                f"SHA-256 {own['sha256'][:16]}"
            ]
            if own
            else []
        ),
    ]


def _step_text(step: Mapping[str, Any]) -> str:
    """`split quality medium, episodes 10   of 5c7e108f`."""
    rule = step.get("rule") or {}
    words = ", ".join(f"{key} {_short(value)}" for key, value in rule.items())
    sources = " and ".join(str(hash)[:8] for hash in step.get("from", ()))
    return f"{step.get('verb', '?')} {words}".rstrip() + f"   of {sources}"


def _short(value: Any) -> str:
    text = " ".join(map(str, value)) if isinstance(value, list) else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def describe_episode(data: Dataset, episode_id: int) -> dict[str, Any]:
    """One row of the episode table as JSON values."""
    columns = data.episodes
    names = {code: name for name, code in QUALITY_CODES.items()}
    quality = names.get(int(columns.quality[episode_id]), "unknown")
    return {
        "id": episode_id,
        "task": data.tasks.names[int(columns.task[episode_id])],
        "quality": quality,
        "length": int(columns.length[episode_id]),
        "return": float(columns.returns[episode_id]),
        "success": bool(columns.success[episode_id]),
        "seed_key": [int(n) for n in columns.seed_key[episode_id]],
    }


def schema() -> tuple[list[dict[str, Any]], str]:
    """The arrays of the file format, as JSON values and as text."""
    groups = {f"/{name}": columns for name, columns in layout.GROUPS.items()}
    for name, columns in layout.TTA_GROUPS.items():
        groups[f"/tta/<name>/{name}".rstrip("/")] = columns
    rows: list[dict[str, Any]] = [
        {
            "path": f"{group}/{column.path}",
            "dtype": "bool" if column.dtype == "?" else column.dtype,
            "shape": list(column.shape),
            "optional": column.optional,
        }
        for group, columns in groups.items()
        for column in columns
    ]
    cells = [
        [row["path"], row["dtype"], "(" + ", ".join(map(str, row["shape"])) + ")",
         "optional" if row["optional"] else ""]
        for row in rows
    ]  # fmt: skip
    legend = (
        "N steps, E episodes, R = N+E observation rows, D / A observation / action size, "
        "K tasks, M goals, G goal size, P policies"
    )
    table = text_table([("dataset", "dtype", "shape", ""), *cells], numbers_from=9)
    return rows, f"{table}\n{legend}"
