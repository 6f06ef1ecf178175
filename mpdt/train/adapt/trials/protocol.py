"""The protocol `trials`: K own episodes on every unseen task, then a policy for fresh ones.

    row alone     the trials and nothing else
    row with_x    X with its rewards first (20 random episodes more)
    row race      prompts are tried, nothing is learnt

What a trial gives: observations without the goal, rewards, successes. No expert's step, no goal,
and no evaluation episode's key: trials have keys of their own (live.py). Tasks are adapted one by
one and share nothing but what was learnt from training tasks.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import torch
from torch import Tensor

from mpdt.data.episode import Episode
from mpdt.model.fingerprint import fingerprint
from mpdt.model.returns import ReturnTable
from mpdt.train.adapt.trials.inside import make_inside
from mpdt.train.adapt.trials.lived import Stretch
from mpdt.train.adapt.trials.schedule import Ground, TaskTrials
from mpdt.train.adapt.trials.settings import TrialRow, TrialSettings
from mpdt.train.adapt.trials.store import Tried, TrialStore
from mpdt.train.evaluate.controller import PerTaskController, PromptController
from mpdt.train.evaluate.score import Reads
from mpdt.train.fit.trained import Trained

OnStep = Callable[[str, int, int, str], None]
LABELS: dict[TrialRow, str] = {
    "alone": "{} own episodes", "with_x": "X and {} own episodes",
    "race": "race of prompts, {} own episodes",
}  # fmt: skip


@dataclass(frozen=True)
class TrialResult:
    """One row of the table.

    Attributes:
        name: in one word, such as trials-alone-10.
        episodes: the trials it read, task by task.
        own_steps: their number of each task.
    """

    name: str
    label: str
    controller: PerTaskController
    reads: Reads
    episodes: tuple[Episode, ...]
    own_steps: tuple[int, ...]


@dataclass(frozen=True)
class Known:
    """What a row may read before its trials: per task weights (1, N) and X, or nothing."""

    weights: Sequence[Tensor | None]
    x: Sequence[Sequence[Stretch]]


def trial_results(
    trained: Trained, settings: TrialSettings, returns: ReturnTable, window: int, horizon: int,
    tasks: int, seed: int, known: Callable[[TrialRow], Known], on_step: OnStep,
    folder: Path | None, facts: Any,
) -> Iterator[TrialResult]:  # fmt: skip
    """Rows in the order asked for, each with every K.

    Args:
        returns: one row per test task.
        tasks: training tasks that may share the weight, as `adapt.infer.tasks`.
        known: what a row may read; asked only for the rows there are.
        folder: where trials are kept, to go on with; None = nowhere.
        facts: what else the trials depend on, as JSON values.
    Raises: TrainingError; FormatError for kept trials that are damaged; whatever `on_step` does.
    """
    inside = make_inside(trained, settings, window, seed, on_step)
    acting = fingerprint(trained.policy, trained.prompts.task_prompts().detach(), trained.returns,
                         window)  # fmt: skip
    for row in dict.fromkeys(settings.rows):
        bound = _hash(settings, row, [acting.hex(), horizon, tasks, seed, facts])
        ground = Ground(trained, inside, settings, window, horizon, tasks, bytes.fromhex(bound))
        found = _all_trials(ground, row, returns, known(row), on_step, folder)
        for count in sorted(set(settings.episodes)):
            yield _result(ground, row, count, returns, found)


def _all_trials(
    ground: Ground, row: TrialRow, returns: ReturnTable, known: Known, on_step: OnStep,
    folder: Path | None,
) -> list[Tried]:  # fmt: skip
    """As many as the largest K, of every task."""
    material, most = ground.trained.material, max(ground.settings.episodes)
    bound, found = ground.fingerprint.hex(), []
    for i, task in enumerate(material.tasks(material.test_rows)):

        def tell(number: int, text: str, name: str = task.name) -> None:
            on_step(f"trials {row} {name}", number, most, text)

        store = None
        if folder is not None:
            path = folder / f"{task.name}-{row}-{bound[:12]}.safetensors"
            store = TrialStore(path, {"trials": bound})
        trials = TaskTrials(
            ground, task, returns.select(torch.tensor([i])), tell, known.weights[i], known.x[i],
            store, race=row == "race",
        )  # fmt: skip
        while len(trials.tried.episodes) < most:
            trials.trial()
        found.append(trials.tried)
    return found


def _result(
    ground: Ground, row: TrialRow, count: int, returns: ReturnTable, found: Sequence[Tried]
) -> TrialResult:
    """What the first `count` trials speak for, task by task."""
    family, actors = ground.trained.material.family, []
    for i, tried in enumerate(found):
        one = tried.contenders[tried.chosen[count]]
        actors.append(
            PromptController(one.policy, one.prompt, returns.select(torch.tensor([i])),
                             ground.window, family.action_low, family.action_high)
        )  # fmt: skip
    lived = [tried.episodes[:count] for tried in found]
    return TrialResult(
        f"trials-{row}-{count}", LABELS[row].format(count), PerTaskController(actors),
        "X+rewards, trials" if row == "with_x" else "trials",
        tuple(episode for episodes in lived for episode in episodes),
        tuple(sum(episode.length for episode in episodes) for episodes in lived),
    )  # fmt: skip


def _hash(settings: TrialSettings, row: TrialRow, facts: Any) -> str:
    """Of all that a row's trials depend on; how many there are is not among it."""
    plain = msgspec.to_builtins(settings)
    del plain["episodes"], plain["rows"]
    text = json.dumps([plain, row, facts], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
