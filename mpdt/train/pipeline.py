"""The whole of `mpdt-train --data FILE`: open, train, judge, write down."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

import torch

from mpdt.model.backbone import from_settings
from mpdt.train.adapt import find_tta_set
from mpdt.train.config import TrainConfig, to_plain
from mpdt.train.folder import RunFolder, open_folder
from mpdt.train.judge import Judge
from mpdt.train.material import Material, load_material
from mpdt.train.progress import Progress
from mpdt.train.report import build_tables, render_markdown
from mpdt.train.results import encode_results, write_atomic
from mpdt.train.run import Trained, Trainer, count_trainables
from mpdt.train.show import read_results
from mpdt.train.state import StopRequest

FORMAT = "mpdt-results/1"


def run_pipeline(
    data: str,
    config: TrainConfig,
    runs_dir: Path,
    name: str,
    restart: bool,
    progress: Progress,
    stop: StopRequest,
    time_limit_s: float = 0.0,
) -> dict[str, Any]:
    """Do, continue or look up one run; returns the content of its results.json.

    Raises: Stopped after a signal, with everything saved that can be; MpdtError for what the
        user can mend, before anything is trained where that can be known.
    """
    material = load_material(data, config.quality)
    if config.adapt.needs_set and material.test_rows:
        find_tta_set(material.dataset, material.test_rows, config.adapt)
    if config.statistics.source == "random" and config.adapt.needs_set:
        material.random_ids()
    progress.say(_describe(material))
    folder = open_folder(runs_dir, name, config, material, restart)
    if folder.results.exists():
        progress.say(f"this run is done: {folder.path} (again: --restart)")
        return read_results(folder.path)
    torch.set_num_threads(config.threads or len(os.sched_getaffinity(0)))
    backbone = from_settings(config.backbone)
    progress.say(
        f"backbone {backbone.name}, {backbone.num_layers} blocks of width {backbone.width}, "
        f"{str(backbone.dtype).removeprefix('torch.')}, weights {backbone.fingerprint[:12]}"
    )
    stop.check()
    trainer = Trainer(material, config, backbone, folder, progress, stop, time_limit_s)
    began_s = time.monotonic()
    trained = trainer.train()
    trained_s = time.monotonic() - began_s
    scores = Judge(trainer, trained).scores()
    seconds = {"training": trained_s, "all": time.monotonic() - began_s}
    header = _header(name, material, config, trained, seconds)
    content = encode_results(header, scores)
    # The report first: results.json is what marks a run as done.
    facts = {
        "name": name,
        "data": _describe(material),
        "backbone": f"{backbone.name}, {backbone.num_layers} blocks, {backbone.fingerprint}",
        "trained numbers": f"{header['num_trainables']:,}",
        "updates": ", ".join(f"{phase} {n}" for phase, n in trained.steps.items()),
    }
    write_atomic(folder.report, render_markdown(facts, build_tables(scores)).encode())
    write_atomic(folder.results, content)
    _forget_checkpoint(folder)
    progress.say(f"written to {folder.path}")
    results: dict[str, Any] = json.loads(content)
    return results


def _describe(material: Material) -> str:
    dataset = material.dataset
    episodes = sum(len(ids) for ids in material.episode_ids.values())
    part = f":{material.slice}" if material.slice else ""
    return (
        f"{dataset.path.name}{part} ({dataset.name} {dataset.version}), content "
        f"{dataset.content_hash}, {material.quality}: {episodes} episodes of "
        f"{len(material.train_rows)} training tasks, {len(material.test_rows)} test tasks"
    )


def _header(
    name: str,
    material: Material,
    config: TrainConfig,
    trained: Trained,
    seconds: dict[str, float],
) -> dict[str, Any]:
    dataset, backbone = material.dataset, trained.policy.backbone
    return {
        "format": FORMAT,
        "name": name,
        "data": {
            "file": dataset.path.name,
            "name": dataset.name,
            "version": dataset.version,
            "content_hash": dataset.content_hash,
            "slice": material.slice,
            "quality": material.quality,
            "horizon": config.evaluation.horizon or material.horizon,
        },
        "backbone": {
            "name": backbone.name,
            "num_layers": backbone.num_layers,
            "width": backbone.width,
            "fingerprint": backbone.fingerprint,
            "dtype": str(backbone.dtype).removeprefix("torch."),
        },
        "num_trainables": count_trainables(trained),
        "updates": dict(trained.steps),
        "seconds": {phase: round(value, 1) for phase, value in seconds.items()},
        "config": to_plain(config),
    }


def _forget_checkpoint(folder: RunFolder) -> None:
    """A finished run needs it no more; the weights stay."""
    folder.checkpoint.unlink(missing_ok=True)
