"""Episodes in memory, laid out as a data file has them: what windows and steps are taken from.

Own trials of a task, X, and the training tasks' episodes that the world model is pretrained on
all come in this form, so each use (steps for the model, windows for a clone) is written once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from mpdt.data.slices.windows import WindowSource
from mpdt.seeding import generator_at
from mpdt.train.adapt.few_shot import LabelledSteps, TrimmedEpisodes
from mpdt.train.adapt.trials.world import Steps
from mpdt.train.fit.data import Material

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class _Columns:
    observations: Floats
    actions: Floats
    rewards: Floats


@dataclass(frozen=True)
class Stretch:
    """One episode: observations (T + 1, D), actions (T, A) as executed, rewards (T,)."""

    observations: Floats
    actions: Floats
    rewards: Floats

    def upto(self, length: int) -> Stretch:
        """Its first steps."""
        return Stretch(self.observations[: length + 1], self.actions[:length],
                       self.rewards[:length])  # fmt: skip


class Lived:
    """Episodes one behind the other.

    Attributes:
        steps, episodes: as an open dataset has them.
    """

    def __init__(self, stretches: Sequence[Stretch]) -> None:
        length = np.array([len(one.rewards) for one in stretches], np.int64)
        start = np.cumsum(length) - length
        self.steps = _Columns(*(np.concatenate([getattr(one, name) for one in stretches])
                                for name in ("observations", "actions", "rewards")))  # fmt: skip
        self.episodes = TrimmedEpisodes(start, start + np.arange(len(length)), length)

    def __len__(self) -> int:
        return len(self.episodes.length)

    def as_steps(self, heads: Sequence[int] | int = 0) -> Steps:
        """Every step, in order.

        Args:
            heads: number of the reward head, of each episode or of all.
        """
        length, columns = self.episodes.length, self.steps
        first = np.repeat(self.episodes.obs_start, length)
        at = first + np.arange(len(columns.rewards)) - np.repeat(self.episodes.start, length)
        of = np.repeat(np.broadcast_to(np.asarray(heads, np.int64), length.shape), length)
        seen = torch.from_numpy(columns.observations)
        return Steps(
            seen[at], seen[first], seen[at + 1], torch.from_numpy(columns.actions),
            torch.from_numpy(columns.rewards), torch.from_numpy(of),
        )  # fmt: skip

    def labelled(self) -> LabelledSteps:
        """All of it, as task row 0: what few-shot tunes on."""
        return LabelledSteps(self.steps, self.episodes, {0: np.arange(len(self))})


def stretches_of(
    source: WindowSource, ids: Sequence[int], rewards: NDArray[Any], low: float, high: float
) -> list[Stretch]:
    """Those episodes of a file or of a TTA set; actions as the simulator executed them."""
    steps, places, found = source.steps, source.episodes, []
    for i in ids:
        begin, seen, length = int(places.start[i]), int(places.obs_start[i]), int(places.length[i])
        found.append(Stretch(
            np.array(steps.observations[seen : seen + length + 1], np.float32),
            np.clip(np.array(steps.actions[begin : begin + length], np.float32), low, high),
            np.array(rewards[begin : begin + length], np.float32),
        ))  # fmt: skip
    return found


def training_stretches(material: Material, most: int, seed: int) -> tuple[list[Stretch], list[int]]:
    """Episodes of the training tasks, half random ones where there are any, half of those trained
    on; and the position of each one's task.

    Args:
        most: of each task; 0 = all.
    """
    dataset, family = material.dataset, material.family
    found: list[Stretch] = []
    heads: list[int] = []
    for head, row in enumerate(material.train_rows):
        kinds = [dataset.select(task=row, quality="random"), material.episode_ids[row]]
        kinds = [ids for ids in kinds if len(ids)]
        generator = generator_at(seed, row)
        for ids in kinds:
            share = len(ids) if most == 0 else max(1, most // len(kinds))
            chosen = np.sort(generator.permutation(ids)[:share]).tolist()
            found += stretches_of(dataset, chosen, dataset.steps.rewards,
                                  family.action_low, family.action_high)  # fmt: skip
            heads += [head] * len(chosen)
    return found, heads
