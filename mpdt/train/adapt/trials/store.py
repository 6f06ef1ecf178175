"""A task's trials on disk, so that a stopped run goes on with the next one.

FOLDER/TASK-ROW-HASH.safetensors    episodes, clones, what was decided; replaced after each trial

The hash is of everything that the trials depend on, so other settings begin anew beside it. World
model and echo are functions of the episodes and are fitted again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from torch import Tensor

from mpdt.data.episode import Episode
from mpdt.errors import FormatError, MissingFileError, quoted
from mpdt.model.policy import PromptPolicy
from mpdt.model.weights import WeightsHeader, load_weights, save_weights
from mpdt.train.adapt.few_shot import own_copy
from mpdt.train.adapt.trials.contenders import Contender

KIND = "trials"
_COLUMNS = ("observations", "actions", "rewards", "terminations", "truncations", "successes",
            "goal")  # fmt: skip


class _Facts(msgspec.Struct, frozen=True):
    acts: list[str]
    chosen: list[int]
    contenders: list[_Contender]
    episodes: list[_Episode]


class _Contender(msgspec.Struct, frozen=True):
    name: str
    returns: list[float]
    successes: list[bool]
    retired: bool
    own: bool
    """A clone, with weights of its own."""


class _Episode(msgspec.Struct, frozen=True):
    task: int
    quality: int
    progress: float
    policy: str
    seed_key: tuple[int, int, int, int, int]


@dataclass
class Tried:
    """A task's trials so far.

    Attributes:
        contenders: policies that they compare.
        chosen: position of the one they speak for, before the first trial and after each.
        weights: (1, N) of the training tasks; those of base.
        acts: what was done in each.
    """

    contenders: list[Contender]
    chosen: list[int]
    weights: Tensor
    episodes: list[Episode]
    acts: list[str]


@dataclass(frozen=True)
class TrialStore:
    """One file.

    Args:
        hashes: what it is bound to.
    """

    path: Path
    hashes: Mapping[str, str]

    def save(self, tried: Tried, shared: PromptPolicy) -> None:
        """Args: shared: the trained policy, which is not written. Raises: StorageError."""
        tensors: dict[str, Tensor] = {"weights": tried.weights}
        for i, one in enumerate(tried.contenders):
            tensors[f"contender.{i}.prompt"] = one.prompt
            if one.policy is not shared:
                own = one.policy.own_state()
                tensors |= {f"contender.{i}.policy.{name}": value for name, value in own.items()}
        for i, episode in enumerate(tried.episodes):
            for column in _COLUMNS:
                if (values := getattr(episode, column)) is not None:
                    tensors[f"episode.{i}.{column}"] = torch.from_numpy(np.array(values))
        facts = _Facts(
            tried.acts, tried.chosen,
            [_Contender(one.name, one.returns, one.successes, one.retired,
                        one.policy is not shared) for one in tried.contenders],
            [_Episode(one.task, one.quality, one.progress, one.policy.hex(), one.seed_key)
             for one in tried.episodes],
        )  # fmt: skip
        header = WeightsHeader(kind=KIND, hashes=dict(self.hashes),
                               settings=msgspec.to_builtins(facts))  # fmt: skip
        save_weights(self.path, tensors, header)

    def load(self, shared: PromptPolicy) -> Tried | None:
        """What is there, or None. Raises: FormatError for a damaged file."""
        try:
            header, tensors = load_weights(self.path, kind=KIND, hashes=self.hashes)
        except MissingFileError:
            return None
        except FormatError as error:
            raise error.with_hint(
                f"move {quoted(self.path)} away: the same command makes its trials again"
            ) from error
        facts = msgspec.convert(header.settings, _Facts)
        contenders = []
        for i, one in enumerate(facts.contenders):
            policy = shared
            if one.own:
                policy = own_copy(shared)
                head = f"contender.{i}.policy."
                policy.load_own_state({name.removeprefix(head): value
                                       for name, value in tensors.items()
                                       if name.startswith(head)})  # fmt: skip
            prompt, ran = tensors[f"contender.{i}.prompt"], (list(one.returns), list(one.successes))
            contenders.append(Contender(one.name, policy, prompt, *ran, one.retired))
        episodes = [_episode(i, one, tensors) for i, one in enumerate(facts.episodes)]
        return Tried(contenders, list(facts.chosen), tensors["weights"], episodes,
                     list(facts.acts))  # fmt: skip


def _episode(i: int, facts: _Episode, tensors: Mapping[str, Tensor]) -> Episode:
    columns: dict[str, Any] = {
        name: tensors[key].numpy() if (key := f"episode.{i}.{name}") in tensors else None
        for name in _COLUMNS
    }
    return Episode(**columns, task=facts.task, quality=facts.quality, progress=facts.progress,
                   policy=bytes.fromhex(facts.policy), seed_key=facts.seed_key)  # fmt: skip
