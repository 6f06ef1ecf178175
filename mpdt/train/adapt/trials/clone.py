"""Learning from own successes: few-shot, with own trials in place of an expert's steps."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from mpdt.data.episode import Episode
from mpdt.model.policy import PromptPolicy
from mpdt.model.prompts import AdaptedPrompts, TrainedPrompts
from mpdt.model.returns import ReturnTable
from mpdt.train.adapt.few_shot import FewShotSettings, tune
from mpdt.train.adapt.trials.live import first_success
from mpdt.train.adapt.trials.lived import Lived, Stretch
from mpdt.train.adapt.trials.settings import TrialSettings


def demonstrations(episodes: Sequence[Episode], settings: TrialSettings) -> list[Stretch]:
    """What a clone learns from: the quickest successes, each with a few steps after it; where
    there is no success at all, the episode of the highest return.

        successes at steps 90, 300, 120; two wanted; tail 60     ->   150 steps and 180 steps
    """
    found = [
        (step, i) for i, one in enumerate(episodes) if (step := first_success(one)) is not None
    ]
    chosen = [(i, step + 1 + settings.tail) for step, i in sorted(found)[: settings.demonstrations]]
    if not chosen:
        i = max(range(len(episodes)), key=lambda i: episodes[i].episode_return)
        chosen = [(i, episodes[i].length)]
    return [stretch_of(episodes[i]).upto(length) for i, length in chosen]


def stretch_of(episode: Episode) -> Stretch:
    return Stretch(episode.observations, episode.actions, episode.rewards)


def clone(
    policy: PromptPolicy, trained: TrainedPrompts, weights: Tensor, shown: Sequence[Stretch],
    window: int, returns: ReturnTable, settings: TrialSettings, seed: int,
) -> tuple[PromptPolicy, Tensor]:  # fmt: skip
    """A policy of its own and its prompt (1, l, s); `policy` and `trained` stay as they are.

    Args:
        weights: (1, N) of the training tasks, whose mixture the prompt starts from.
        returns: one row.
    """
    few_shot = FewShotSettings(tuned="all", updates=settings.updates, lr=settings.lr)
    start = AdaptedPrompts(trained, "infer_aligned", 1, weights)
    tuned = tune(policy, start, Lived(shown).labelled(), [0], window, returns, few_shot, seed)
    own, prompt = tuned[0]
    for parameter in own.parameters():
        parameter.grad = None
    return own, torch.Tensor(prompt)
