"""One step of our simulator from some stored states: what imports have in place of a replay.

    stored   o_t  a_t -> o_t+1  r_t           differences of the largest component, and of the
    ours     o_t  a_t -> o'     r'            reward: median and worst

An import has no seeds, so nothing in it can be simulated again. Where the family can set its state
from an observation, every step is an episode of one. Another version of MuJoCo differs a little, in
contacts more; another reward or robot stands out. Meta-World's state cannot be set so: docs/log.md,
experiments/metaworld_one_step.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mpdt.data.spec.family import resolve
from mpdt.data.store.dataset import Dataset
from mpdt.data.verify.finding import Finding, Outcome
from mpdt.data.verify.material import Material

MOST = 2_000
STRANGE = 0.2
"""Of the rewards' standard deviation: a median difference beyond is another reward."""


@dataclass(frozen=True)
class Differences:
    """Of `steps` steps; (median, worst) of the largest component and of the reward."""

    steps: int
    observation: tuple[float, float]
    reward: tuple[float, float]
    spread: float

    def text(self) -> str:
        """`one step of our simulator from 2,000 stored states: ...`."""
        (one, two), (three, four) = self.observation, self.reward
        return (f"one step of our simulator from {self.steps:,} stored states: observations differ "
                f"by {one:.2g} in the median, {two:.2g} at worst, rewards by {three:.2g} and "
                f"{four:.2g}")  # fmt: skip


def differences(dataset: Dataset, most: int = MOST) -> Differences | None:
    """Of steps evenly spaced over a file; None where its family cannot do it.

    Raises: as the family's `one_step`.
    """
    family = dataset.contract()
    if family.one_step is None or not len(dataset.episodes):
        return None
    lengths = np.asarray(dataset.episodes.length)
    total = int(lengths.sum())
    chosen = np.unique(np.linspace(0, total - 1, min(most, total)).astype(np.int64))
    ends = np.cumsum(lengths)
    of = np.searchsorted(ends, chosen, side="right")
    first, second, actions, rewards, goals = [], [], [], [], []
    for number in np.unique(of).tolist():
        episode = dataset.episode(number)
        at = chosen[of == number] - (ends[number] - lengths[number])
        first.append(episode.observations[at])
        second.append(episode.observations[at + 1])
        actions.append(episode.actions[at])
        rewards.append(episode.rewards[at])
        goals.append(np.repeat(episode.goal[np.newaxis], len(at), axis=0))
    options = dict(dataset.spec.get("env") or {})
    found, paid = resolve(family.one_step)(
        family, np.concatenate(first).astype(np.float64), np.concatenate(actions),
        np.concatenate(goals), options,
    )  # fmt: skip
    told = ~np.isnan(found).all(axis=0)
    apart = np.abs(found - np.concatenate(second))[:, told].max(axis=1)
    stored = np.concatenate(rewards).astype(np.float64)
    off = np.abs(paid - stored)
    return Differences(len(chosen), (float(np.median(apart)), float(apart.max())),
                       (float(np.median(off)), float(off.max())), float(stored.std()))  # fmt: skip


def with_one_step(bare: Finding, material: Material) -> Finding:
    """A finding that nothing can be replayed, with what one step says where it can be made."""
    family = material.family
    if not material.is_imported or family is None or not len(material.dataset.episodes):
        return bare
    if (found := differences(material.dataset)) is None:
        if not family.simulates:
            return bare
        return replace(bare, text=f"{bare.text}; nor is one step compared: an observation of "
                       f"{family.name} does not tell its simulator's state")  # fmt: skip
    text = f"{bare.text}; {found.text()}"
    if not found.reward[0] <= STRANGE * found.spread:
        outcome = Outcome.FAIL if bare.outcome is Outcome.FAIL else Outcome.WARN
        return Finding(bare.id, outcome, f"{text}: another reward, or another robot",
                       hint="is it this family, and are the rewards its own?")  # fmt: skip
    return replace(bare, text=text)
