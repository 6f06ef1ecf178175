"""A trained run opened again, for scripts that ask it things that no table asks."""

from __future__ import annotations

from pathlib import Path

import torch

from mpdt.model.backbone import from_settings
from mpdt.train.fit.data import load_material
from mpdt.train.run.config import from_plain
from mpdt.train.run.folder import locate
from mpdt.train.run.identity import identify
from mpdt.train.run.progress import Progress
from mpdt.train.run.show import read_results
from mpdt.train.run.stop import StopRequest
from mpdt.train.run.trainer import Trained, Trainer

SEED = 1000  # of evaluation episodes: not those of any table of results


def open_run(run: Path, data: str) -> tuple[Trainer, Trained]:
    """The trainer with its data, and what it trained. Raises: MpdtError."""
    config = from_plain(read_results(run)["config"])
    torch.set_num_threads(config.threads or 1)
    material = load_material(data, config.quality)
    trainer = Trainer(
        material, config, from_settings(config.backbone), locate(run.parent, run.name), Progress(),
        StopRequest(), run_hash=identify(config, material).hashes["training"],
    )  # fmt: skip
    trainer.prepare()
    return trainer, trainer.train()
