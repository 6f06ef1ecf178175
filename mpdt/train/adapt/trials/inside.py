"""What the trials of all tasks of a run begin with: world model, echo, and the prompts they offer.

Made once per run from the training tasks alone; a function of the data, the weights and the seed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mpdt.data.spec.tasks import Family
from mpdt.train.adapt.trials.echo import Echo, answers, teach
from mpdt.train.adapt.trials.features import Features
from mpdt.train.adapt.trials.lived import Lived, training_stretches
from mpdt.train.adapt.trials.settings import TrialSettings
from mpdt.train.adapt.trials.world import WorldModel, pretrain
from mpdt.train.fit.trained import Trained

MOST_VOICES = 12
"""Prompts whose echo is heard; of more training tasks these are evenly spaced."""


@dataclass(frozen=True)
class Inside:
    """Attributes:
    features, world: None where nobody asks them. echo: None where nothing is planned.
    voices: (V, l, s) prompts of training tasks.
    """

    features: Features | None
    world: WorldModel | None
    echo: Echo | None
    voices: Tensor


def plans(settings: TrialSettings, family: Family) -> bool:
    """Whether a planner acts in some trial; in a race none does."""
    learns = set(settings.rows) != {"race"}
    return learns and (family.has_success or settings.search == "plan")


def make_inside(
    trained: Trained, settings: TrialSettings, window: int, seed: int,
    on_step: Callable[[str, int, int, str], None],
) -> Inside:  # fmt: skip
    """Pretrain everything. Raises: TrainingError; whatever `on_step` does."""
    material = trained.material
    N = len(material.train_rows)
    chosen = np.unique(np.linspace(0, N - 1, min(N, MOST_VOICES)).round().astype(np.int64))
    rows = torch.from_numpy(chosen)
    with torch.no_grad():
        voices = trained.prompts.task_prompts()[rows].detach()
    planned = plans(settings, material.family)
    read = settings.infer == "world" and set(settings.rows) != {"race"}
    if not (planned or read):
        return Inside(None, None, None, voices)
    stretches, heads = training_stretches(material, settings.world.episodes, seed)
    lived = Lived(stretches)
    steps = lived.as_steps(heads)
    features = Features(material.family, steps.observations, steps.following - steps.observations)

    def tell(done: int, loss: float) -> None:
        on_step("world model", done, settings.world.pretraining, f"loss {loss:.4f}")

    world = pretrain(features, steps, N, settings.world, seed, tell)
    echo = None
    if planned and settings.planner.echoes:
        wished = answers(
            trained.policy, voices, trained.returns.select(rows), lived, window,
            lambda done, of: on_step("echo", done, of, f"{len(voices)} prompts"),
        )  # fmt: skip
        echo = teach(features, lived, wished, settings.world.echo, seed)
    return Inside(features, world, echo, voices)
