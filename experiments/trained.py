"""A trained run opened again, for scripts that ask it things that no table asks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from mpdt.train.adapt.candidates import Candidates
from mpdt.train.evaluate.rollout import Evaluation, SimulatorCache, evaluate
from mpdt.train.fit.trained import Trained
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.folder import stored_settings
from mpdt.train.run.progress import Progress
from mpdt.train.run.stored import load_trained

SEED = 1000  # of evaluation episodes: not those of any table of results


def open_run(run: Path, data: str) -> tuple[TrainConfig, Trained]:
    """The settings of a run and what it trained, with its data. Raises: MpdtError."""
    config = stored_settings(run)
    torch.set_num_threads(config.threads or 1)
    return config, load_trained(run, data)


def judged_behind(
    config: TrainConfig, trained: Trained, mixtures: Mapping[str, Tensor], episodes: int
) -> Iterator[tuple[str, Evaluation]]:
    """The training tasks behind mixtures of their prompts, one row of weights (n, N) for each."""
    material, settings, progress = trained.material, config.evaluation, Progress()
    with torch.no_grad():
        parts, cross = trained.prompts.task_parts(), trained.prompts.cross
    candidates, cache = Candidates(trained, config), SimulatorCache()
    for name, weights in mixtures.items():
        prompts = cross * torch.einsum("nk,kls->nls", weights, parts)
        yield name, evaluate(
            candidates.controller(prompts, trained.returns), material.family,
            material.tasks(material.train_rows), material.options,
            settings.horizon or material.horizon, episodes, SEED, settings.max_rows,
            partial(progress.update, name), cache.make,
        )  # fmt: skip
