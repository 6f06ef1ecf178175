"""One task's world model and echo, and the planner that acts with them.

    before a trial     from the pretrained ones: X, trials before, what there is of this one
    every few steps    the model goes on learning from the trial so far, another member is drawn

All of it is a function of the episodes and the trial's key, so nothing of it is kept on disk. That
the model learns within the trial matters: a plan goes where the model is wrong in its favour, and
stays there until the model has seen that it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mpdt.data.episode import Episode
from mpdt.data.sim.play import Record
from mpdt.model.returns import ReturnTable
from mpdt.seeding import SeedKey, Stream, generator_at
from mpdt.train.adapt.trials.clone import stretch_of
from mpdt.train.adapt.trials.echo import Echo, answers, teach
from mpdt.train.adapt.trials.inside import Inside
from mpdt.train.adapt.trials.live import Act, Floats
from mpdt.train.adapt.trials.lived import Lived, Stretch
from mpdt.train.adapt.trials.planner import Planner, WorldStep
from mpdt.train.adapt.trials.settings import TrialSettings
from mpdt.train.adapt.trials.world import Steps, WorldModel, refit
from mpdt.train.fit.trained import Trained

X_ECHOED = 4  # episodes of X that the echo is taught on: the policy has to answer at each step


@dataclass
class OwnModel:
    """Of one task.

    Args:
        returns: one row, what is asked of it.
        x: X with its rewards, or nothing.
    """

    trained: Trained
    inside: Inside
    settings: TrialSettings
    window: int
    returns: ReturnTable
    x: Sequence[Stretch]
    _wished: list[Tensor] = field(default_factory=list)

    def planning(
        self, episodes: Sequence[Episode], now: Stretch | None, number: int, key: SeedKey
    ) -> Act:
        """Who plans the rest of a trial.

        Args:
            episodes: the trials before.
            now: this one so far; None at its beginning.
        number: of trials that planned from their beginning, before this one.
        """
        settings, family = self.settings, self.trained.material.family
        seed = key.env_seed(Stream.UNIFORM)
        whole = [*self.x, *map(stretch_of, episodes)]
        known = whole if now is None else [*whole, now]
        world = self.inside.world
        assert world is not None, "planned without a world model"
        steps = Lived(known).as_steps() if known else None
        if steps is not None:
            newest = len(known[-1].rewards)
            world = refit(world, steps, newest, settings.world.refitting, seed)
        planner = Planner(
            _member(world, seed, 0), self._echo(whole, now, seed), len(self.inside.voices),
            family.action_size, family.action_low, family.action_high, settings.planner,
            key.generator(Stream.POLICY),
            settings.planner.probing > 0 and (number + 1) % settings.planner.probing == 0,
        )  # fmt: skip
        before = Lived(whole).as_steps() if whole else None
        return _Planning(planner, world, before, settings, seed).act

    def _echo(self, whole: Sequence[Stretch], now: Stretch | None, seed: int) -> Echo | None:
        """The prompts' echo, taught on what this task has shown as well."""
        inside = self.inside
        if inside.echo is None or inside.features is None or not (whole or now):
            return inside.echo
        x = self.x[:X_ECHOED]
        shown = [*x, *whole[len(self.x) :]]
        for one in shown[len(self._wished) :]:
            self._wished.append(self._answered(one))
        wished = list(self._wished)
        if now is not None:
            shown, wished = [*shown, now], [*wished, self._answered(now)]
        return teach(inside.features, Lived(shown), torch.cat(wished),
                     self.settings.world.echo // 10, seed, inside.echo)  # fmt: skip

    def _answered(self, one: Stretch) -> Tensor:
        rows = torch.zeros(len(self.inside.voices), dtype=torch.long)
        return answers(self.trained.policy, self.inside.voices, self.returns.select(rows),
                       Lived([one]), self.window)  # fmt: skip


@dataclass
class _Planning:
    """The planner, and a model that goes on learning.

    Args:
        before: steps of what came before this trial.
    """

    planner: Planner
    world: WorldModel
    before: Steps | None
    settings: TrialSettings
    seed: int
    _since: int = 0

    def act(self, step: int, seen: Floats, _: float | None, record: Record) -> NDArray[np.floating]:
        """The planned action; nothing any more once it has succeeded and the tail is over."""
        settings, reached = self.settings, record.successes
        if reached is not None and reached[0, : max(0, step - settings.tail)].any():
            return np.zeros(self.planner.action_size, np.float32)
        self._since += 1
        if settings.world.every and self._since % settings.world.every == 0:
            now = Lived([Stretch(record.observations[0, : step + 1], record.actions[0, :step],
                                 record.rewards[0, :step])]).as_steps()  # fmt: skip
            steps = now if self.before is None else Steps.joined([self.before, now])
            self.world = refit(self.world, steps, step, settings.world.refreshing, self.seed + step)
            self.planner.world = _member(self.world, self.seed, step)
        return self.planner.act(seen, record.observations[0, 0])


def _member(world: WorldModel, seed: int, step: int) -> WorldStep:
    """One of the ensemble (Thompson sampling), a function of (seed, step)."""
    return world.pick(int(generator_at(seed, step).integers(world.settings.members)))
