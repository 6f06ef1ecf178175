"""What `mpdt-train rollout` prints: the file, and what the policy reached in it."""

from __future__ import annotations

import json
import sys

from mpdt.data.collect.rollouts import RolledOut
from mpdt.data.verbs.options import text_table


def print_rolled_out(done: RolledOut, as_json: bool) -> None:
    """A table on stdout, or JSON; a level that is not known is null."""
    data = done.dataset
    counts = [len(data.select(task=one.task)) for one in done.reached]
    successes = [_success(done, one.task) for one in done.reached]
    if as_json:
        tasks = [
            {"task": one.task, "episodes": count, "return": one.mean,
             "level": None if one.level != one.level else one.level, "success": success}
            for one, count, success in zip(done.reached, counts, successes, strict=True)
        ]  # fmt: skip
        found = {
            "path": str(data.path), "content_hash": data.content_hash, "episodes": sum(counts),
            "steps": data.num_steps, "policy": data.policies.hashes[0].tobytes().hex(),
            "tasks": tasks,
        }  # fmt: skip
        sys.stdout.write(json.dumps(found, indent=1) + "\n")
        return
    rows = [
        [one.task, f"{count:,}", f"{one.mean:.1f}", _two(one.level), _two(success)]
        for one, count, success in zip(done.reached, counts, successes, strict=True)
    ]
    sys.stdout.write(text_table([("task", "episodes", "return", "level", "success"), *rows]))
    sys.stdout.write(
        f"\n{data.path}: {sum(counts):,} episodes, {data.num_steps:,} steps, "
        f"content {data.content_hash[:8]}\n"
    )


def _success(done: RolledOut, task: str) -> float | None:
    data = done.dataset
    if data.steps.successes is None:
        return None
    return float(data.episodes.success[data.select(task=task)].mean())


def _two(value: float | None) -> str:
    return "-" if value is None or value != value else f"{value:.2f}"
