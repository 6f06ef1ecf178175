"""A trained run opened again, for scripts that ask it things that no table asks."""

from __future__ import annotations

from pathlib import Path

import torch

from mpdt.train.fit.trained import Trained
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.folder import stored_settings
from mpdt.train.run.stored import load_trained

SEED = 1000  # of evaluation episodes: not those of any table of results


def open_run(run: Path, data: str) -> tuple[TrainConfig, Trained]:
    """The settings of a run and what it trained, with its data. Raises: MpdtError."""
    config = stored_settings(run)
    torch.set_num_threads(config.threads or 1)
    return config, load_trained(run, data)
