"""What the world model sees of a step, and how its answer becomes the next observation.

    observation (B, D), first of the episode, action (B, A)
        ->  where everything is, how far it has come since the first step, how fast it moves,
            how near things are to each other at sharp scales, the action         (B, F)
    change of the moving columns (B, M)
        ->  next observation: moved, with the columns of the step before copied

Everything is found by the names of the columns: `previous_x` holds what `x` held a step ago,
`hand`, `object1` and `object2` are places. A robot without such columns has fewer inputs.
"""

from __future__ import annotations

import torch
from torch import Tensor

from mpdt.data.spec.tasks import Family

SCALES_M = (0.01, 0.03, 0.1, 0.3)
"""A distance d is seen as exp(-d / scale): touching and nearly touching are different things."""
REACH_M = 0.1
_CLIP = 10.0  # standard deviations; an unseen task may show what no training task did
_LEAST = 1e-3  # of a column's spread: what hardly moves in training must not blow up elsewhere
_BEFORE = "previous_"


class Features:
    """Columns of a family, with the spread that training tasks gave them.

    Args:
        observations, changes: (T, D) of training tasks; a change is the next less this one.
    Attributes:
        moving: (M,) columns whose change is predicted.
        change: (M,) spread of these changes.
    """

    def __init__(self, family: Family, observations: Tensor, changes: Tensor) -> None:
        names = [column.split(" ")[0] for column in family.columns]
        at = {name: column for column, name in enumerate(names)}
        hidden = set(family.hidden_columns)
        copied = [(at[name.removeprefix(_BEFORE)], at[name]) for name in names
                  if name.startswith(_BEFORE) and name.removeprefix(_BEFORE) in at]  # fmt: skip
        old = {target for _, target in copied}
        self.moving = torch.tensor([i for i in range(len(names)) if i not in old | hidden])
        self._sources = torch.tensor([source for source, _ in copied], dtype=torch.long)
        self._old = torch.tensor([target for _, target in copied], dtype=torch.long)
        self.mean = observations[:, self.moving].mean(dim=0)
        self.std = observations[:, self.moving].std(dim=0).clamp_min(_LEAST)
        self.change = changes[:, self.moving].std(dim=0).clamp_min(1e-6)
        place = {who: [at[f"{who}_{axis}"] for axis in "xyz"]
                 for who in ("hand", "object1", "object2") if f"{who}_x" in at}  # fmt: skip
        self._places = place if len(place) == 3 else {}
        self._speed = torch.ones(len(copied))
        if copied:
            self._speed = changes[:, self._sources].std(dim=0).clamp_min(1e-6)

    def inputs(self, observations: Tensor, first: Tensor, actions: Tensor) -> Tensor:
        """(B, D), (B, D), (B, A) -> (B, F)."""
        now = observations[:, self.moving]
        parts = [
            ((now - self.mean) / self.std).clamp(-_CLIP, _CLIP),
            ((now - first[:, self.moving]) / self.std).clamp(-_CLIP, _CLIP),
        ]
        if len(self._old):
            moved = observations[:, self._sources] - observations[:, self._old]
            parts.append((moved / self._speed).clamp(-_CLIP, _CLIP))
        if self._places:
            hand, one, two = (observations[:, columns] for columns in self._places.values())
            _, one_first, two_first = (first[:, columns] for columns in self._places.values())
            apart = torch.stack([one - hand, two - hand, one - one_first, two - two_first], dim=1)
            distance = apart.norm(dim=2)
            parts.append(apart.flatten(1) / REACH_M)
            parts += [(-distance / scale).exp() for scale in SCALES_M]
        return torch.cat([*parts, actions], dim=1)

    def advance(self, observations: Tensor, changes: Tensor) -> Tensor:
        """Next observations (B, D) from predicted changes (B, M), in units of their spread."""
        following = observations.clone()
        following[:, self.moving] += changes * self.change
        if len(self._old):
            following[:, self._old] = observations[:, self._sources]
        return following
