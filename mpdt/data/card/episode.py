"""One episode as a terminal shows it: who acted, how the reward went, what the actions were."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mpdt.data.card.facts import QUALITIES
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.proof import proven
from mpdt.data.store.tables import Float64

TICKS = "▁▂▃▄▅▆▇█"
WIDTH = 72


def episode_facts(data: Dataset, episode_id: int) -> dict[str, Any]:
    """Everything about one episode but its observations, as JSON values.

    Raises: UsageError for an id outside the file; FormatError for a damaged episode.
    """
    episode, columns, i = proven(data, episode_id), data.episodes, episode_id
    names = {code: name for name, code in QUALITIES.items()}
    rewards = np.asarray(episode.rewards, np.float64)
    actions = np.asarray(episode.actions, np.float64)
    successes = None if episode.successes is None else np.flatnonzero(episode.successes)
    return {
        "file": data.path.name,
        "id": i,
        "task": data.tasks.names[int(columns.task[i])],
        "quality": names[episode.quality],
        "policy": data.policies.names[int(columns.policy[i])],
        "progress": round(episode.progress, 4),
        "goal": episode.goal.tolist(),
        "seed_key": list(episode.seed_key),
        "digest": columns.digest[i].tobytes().hex(),
        "length": episode.length,
        "return": float(columns.returns[i]),
        "terminated": bool(episode.terminations[-1]),
        "truncated": bool(episode.truncations[-1]),
        "successes": None if successes is None else len(successes),
        "first_success": None if successes is None or not len(successes) else int(successes[0]) + 1,
        "rewards": rewards.tolist(),
        "return_so_far": np.cumsum(rewards).tolist(),
        "actions": [
            {"column": column, "mean": float(values.mean()), "std": float(values.std()),
             "min": float(values.min()), "max": float(values.max())}
            for column, values in enumerate(actions.T)
        ],
    }  # fmt: skip


def episode_text(found: dict[str, Any]) -> list[str]:
    """The lines for a terminal, all but the table of actions."""
    goal = " ".join(f"{number:g}" for number in found["goal"]) or "not stored"
    ends = [word for word in ("terminated", "truncated") if found[word]]
    success = ""
    if found["successes"] is not None:
        first = found["first_success"]
        success = f"   success from step {first}" if first else "   no success"
    rewards = np.array(found["rewards"])
    so_far = np.array(found["return_so_far"])
    return [
        f"{found['file']}   episode {found['id']}   {found['task']}   {found['quality']}",
        f"policy   {found['policy']}   progress {found['progress']:g}   goal {goal}",
        f"seed key {'/'.join(map(str, found['seed_key']))}   digest {found['digest'][:16]}",
        f"end      {' and '.join(ends) or 'no flag'} after {found['length']} steps{success}",
        "",
        f"reward   {sparkline(rewards, WIDTH)}",
        f"         {rewards.min():,.3f} to {rewards.max():,.3f}, mean {rewards.mean():,.3f}",
        f"so far   {sparkline(so_far, WIDTH)}",
        f"         return {found['return']:,.2f}",
    ]


def sparkline(values: Sequence[float] | Float64, width: int) -> str:
    """Numbers as blocks of eight heights; longer series as means of equal parts.

    0 1 2 3 4 5 6 7 -> ▁▂▃▄▅▆▇█      a constant -> ▁▁▁      what is no number -> a space
    """
    numbers = np.asarray(values, np.float64)
    if len(numbers) > width:
        edges = np.linspace(0, len(numbers), width + 1).astype(int)
        numbers = np.array([part.mean() for part in np.split(numbers, edges[1:-1])])
    known = numbers[np.isfinite(numbers)]
    low, span = (float(known.min()), float(np.ptp(known))) if len(known) else (0.0, 0.0)
    heights = (numbers - low) / (span or 1.0) * (len(TICKS) - 1)
    return "".join(TICKS[round(h)] if np.isfinite(h) else " " for h in heights.tolist())
