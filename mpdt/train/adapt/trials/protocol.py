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
from mpdt.data.spec.tasks import Family
from mpdt.model.fingerprint import fingerprint
from mpdt.model.returns import ReturnTable
from mpdt.seeding import phase_seed
from mpdt.train.adapt.align import AdaptationSet, AdaptSettings
from mpdt.train.adapt.infer import InferSettings
from mpdt.train.adapt.trials.inside import make_inside, plans
from mpdt.train.adapt.trials.lived import Stretch, stretches_of
from mpdt.train.adapt.trials.schedule import Ground, TaskTrials
from mpdt.train.adapt.trials.settings import BEFORE_THERE_WAS_A_CHOICE, TrialRow, TrialSettings
from mpdt.train.adapt.trials.store import TrialStore, Tried
from mpdt.train.evaluate.controller import PerTaskController, PromptController
from mpdt.train.evaluate.score import Reads
from mpdt.train.fit.reward import fit_reward_model, read_training_tasks
from mpdt.train.fit.trained import Trained

OnStep = Callable[[str, int, int, str], None]
LABELS: dict[TrialRow, str] = {
    "alone": "{} own episodes", "with_x": "X and {} own episodes",
    "race": "race of prompts, {} own episodes",
}  # fmt: skip
"""How a row is called; the table of protocols looks for the count at the end."""


def spoken(name: str) -> str:
    """trials-alone-10 -> 10 own episodes; names of other candidates stay."""
    for row, label in LABELS.items():
        head, _, count = name.rpartition("-")
        if head == f"trials-{row}" and count.isdecimal():
            return label.format(count)
    return name


@dataclass(frozen=True)
class TrialResult:
    """One row of the table.

    Attributes:
        name: in one word, such as trials-alone-10.
        episodes: the trials it read, task by task.
        own_steps: their number of each task.
        prompts: (n, l, s) the trained policy acts behind; None where a clone acts for some task.
    """

    name: str
    label: str
    controller: PerTaskController
    reads: Reads
    episodes: tuple[Episode, ...]
    own_steps: tuple[int, ...]
    prompts: Tensor | None


@dataclass(frozen=True)
class Known:
    """What a row may read before its trials: per task weights (1, N) and X, or nothing."""

    weights: Sequence[Tensor | None]
    x: Sequence[Sequence[Stretch]]


def trial_results(
    trained: Trained, adapt: AdaptSettings, returns: ReturnTable, window: int, horizon: int,
    seed: int, x: AdaptationSet | None, inferred: Callable[[], Tensor], on_step: OnStep,
    folder: Path | None,
) -> Iterator[TrialResult]:  # fmt: skip
    """Rows in the order asked for, each with every K.

    Args:
        returns: one row per test task.
        seed: of the run.
        x, inferred: X, and the weights (n, N) that it gives; looked at only for the row with X.
        folder: where trials are kept, to go on with; None = nowhere.
    Raises: TrainingError; FormatError for kept trials that are damaged; whatever `on_step` does.
    """
    settings, tasks, material = adapt.trials, adapt.infer.tasks, trained.material
    seed = phase_seed(seed, "trials")
    inside = make_inside(trained, settings, window, seed, on_step)
    rewards = None
    climbs = "with_x" in settings.rows and not plans(settings, material.family)
    if settings.infer == "rewards" and ("alone" in settings.rows or climbs):
        rewards = fit_reward_model(
            read_training_tasks(material), adapt.infer, seed,
            lambda done, loss: on_step("reward model", done, adapt.infer.steps, f"{loss:.4f}"),
        )  # fmt: skip
    acting = fingerprint(trained.policy, trained.prompts.task_prompts().detach(), trained.returns,
                         window)  # fmt: skip
    facts = [acting.hex(), horizon, seed, material.dataset.content_hash, adapt.set,
             adapt.episodes]  # fmt: skip
    n = len(material.test_rows)
    for row in dict.fromkeys(settings.rows):
        known = Known([None] * n, [()] * n)
        if row == "with_x":
            assert x is not None
            known = Known([own[None] for own in inferred()], _shown(x, material.family))
        ground = Ground(trained, inside, settings, window, horizon, tasks,
                        _hash(settings, row, [*facts, _told(adapt.infer, row)]),
                        rewards)  # fmt: skip
        found = _all_trials(ground, row, returns, known, on_step, folder)
        for count in sorted(set(settings.episodes)):
            yield _result(ground, row, count, returns, found)


def _told(infer: InferSettings, row: TrialRow) -> dict[str, Any]:
    """What counts of how X tells; rows without X are told by rewards, whatever is asked of X."""
    asked = infer if row == "with_x" else msgspec.structs.replace(infer, by="rewards")
    return asked.facts


def _shown(x: AdaptationSet, family: Family) -> list[list[Stretch]]:
    """X of each task, with its rewards."""
    rewards, box = x.rewards(), (family.action_low, family.action_high)
    return [stretches_of(x.source, ids.tolist(), rewards, *box) for ids in x.ids]


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
    trained, family = ground.trained, ground.trained.material.family
    chosen = [tried.contenders[tried.chosen[count]] for tried in found]
    actors = [
        PromptController(one.policy, one.prompt, returns.select(torch.tensor([i])), ground.window,
                         family.action_low, family.action_high)
        for i, one in enumerate(chosen)
    ]  # fmt: skip
    is_trained = all(one.policy is trained.policy for one in chosen)
    lived = [tried.episodes[:count] for tried in found]
    return TrialResult(
        f"trials-{row}-{count}", LABELS[row].format(count), PerTaskController(actors),
        "X+rewards, trials" if row == "with_x" else "trials",
        tuple(episode for episodes in lived for episode in episodes),
        tuple(sum(episode.length for episode in episodes) for episodes in lived),
        torch.cat([one.prompt for one in chosen]) if is_trained else None,
    )  # fmt: skip


def _hash(settings: TrialSettings, row: TrialRow, facts: Sequence[Any]) -> bytes:
    """Of all that a row's trials depend on; how many there are is not among it."""
    plain = msgspec.to_builtins(settings)
    del plain["episodes"], plain["rows"]
    for name, before in BEFORE_THERE_WAS_A_CHOICE.items():
        if plain[name] == before or row == "race":  # which reads none of them
            del plain[name]
    text = json.dumps([plain, row, facts], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).digest()
