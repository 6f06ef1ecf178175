"""The whole of `mpdt-train --data FILE`: open, train, judge, write down."""

from __future__ import annotations

import json
import os
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from mpdt.disk import disk
from mpdt.draw.table import markdown_page
from mpdt.errors import MissingFileError, UsageError
from mpdt.model.backbone import from_settings
from mpdt.train.evaluate.score import encode_results, write_atomic
from mpdt.train.evaluate.tables import NORMALISED, build_tables
from mpdt.train.fit.data import Material, load_material
from mpdt.train.fit.group import Group
from mpdt.train.run.config import TrainConfig, to_plain
from mpdt.train.run.folder import claimed, inspect, locate
from mpdt.train.run.identity import Identity, identify
from mpdt.train.run.judge import Judge
from mpdt.train.run.progress import Progress
from mpdt.train.run.show import find_results, set_aside
from mpdt.train.run.stop import StopRequest
from mpdt.train.run.trainer import Trained, Trainer, count_trainables

FORMAT = "mpdt-results/1"
VERSIONED = ("mpdt", "torch", "transformers", "numpy", "mujoco", "metaworld")


def run_pipeline(
    data: str,
    config: TrainConfig,
    runs_dir: Path,
    name: str,
    restart: bool,
    progress: Progress,
    stop: StopRequest,
    time_limit_s: float = 0.0,
    must_be_trained: bool = False,
) -> dict[str, Any]:
    """Do, continue or look up one run; returns the content of its results.json.

    Args:
        must_be_trained: judge what is there; train nothing.

    Raises: Stopped after a signal, with everything saved that can be; MpdtError for what the
        user can mend, before anything is written or trained where that can be known.
    """
    if not time_limit_s >= 0:
        raise UsageError("setting out of range", where="--time-limit-s",
                         expected="at least 0", found=str(time_limit_s))  # fmt: skip
    group = Group.join()
    if group.size > 1 and config.inputs.return_dropout:
        raise UsageError("return dropout is drawn for whole batches, not for a process's share",
                         where="inputs.return_dropout", expected="0 with torchrun",
                         found=str(config.inputs.return_dropout))  # fmt: skip
    # Every process keeps checkpoints of its own; what is judged and kept is the first one's.
    folder = locate(runs_dir, name if group.rank == 0 else f"{name}.rank-{group.rank}")
    material = load_material(data, config.quality)
    random = config.statistics.source == "random" and config.adapt.aligns
    if material.test_rows and (random or config.adapt.infers):
        material.random_ids()
    identity = identify(config, material)
    progress.say(_describe(material))
    done = None if restart else find_results(folder.path, identity.hashes)
    # Only the first process has results; none may go on while another is gone.
    if group.any([done is not None])[0]:
        group.leave()
        progress.say(f"this run is done: {folder.path} (again: --restart)")
        return done or {}
    inspect(folder, identity, restart)
    if must_be_trained and not folder.weights.exists():
        raise MissingFileError("no trained weights in this run", where=str(folder.path),
                               hint=f"mpdt-train --data {data} --name {name}")  # fmt: skip
    stop.check()
    torch.set_num_threads(config.threads or len(os.sched_getaffinity(0)))
    backbone = from_settings(config.backbone)
    progress.say(
        f"backbone {backbone.name}, {backbone.num_layers} blocks of width {backbone.width}, "
        f"{str(backbone.dtype).removeprefix('torch.')}, weights {backbone.fingerprint[:12]}"
    )
    trainer = Trainer(
        material, config, backbone, folder, progress, stop, time_limit_s,
        identity.hashes["training"], group,
    )  # fmt: skip
    # Whatever can be refused has been refused by now, and nothing was written yet.
    trainer.prepare()
    stop.check()
    with claimed(folder, identity, restart):
        if group.rank > 0:
            trainer.train()
            group.leave()
            return {}
        return _train_and_judge(trainer, name, identity)


def _train_and_judge(trainer: Trainer, name: str, identity: Identity) -> dict[str, Any]:
    """The content of results.json, written."""
    material, folder, progress = trainer.material, trainer.folder, trainer.progress
    began_s = time.monotonic()
    trained = trainer.train()
    trainer.group.leave()
    trained_s = time.monotonic() - began_s
    if not trained.complete:
        progress.say(f"training ended by --time-limit-s: {_updates(trained)}")
    scores = Judge(trainer, trained).scores()
    seconds = {"training": trained_s, "all": time.monotonic() - began_s}
    header = _header(name, material, trainer.config, trained, seconds)
    header["identity"] = identity.hashes
    content = encode_results(header, scores)
    backbone = trainer.backbone
    facts = {
        "name": name,
        "data": _describe(material),
        "backbone": f"{backbone.name}, {backbone.num_layers} blocks, {backbone.fingerprint}",
        "trained numbers": f"{header['num_trainables']:,}",
        "updates": _updates(trained),
    }
    # results.json goes first and comes last: it is what marks a run as done.
    with disk(folder.results):
        set_aside(folder)
    write_atomic(folder.report, markdown_page(facts, build_tables(scores), NORMALISED).encode())
    write_atomic(folder.results, content)
    with disk(folder.path):
        folder.judged(identity.hashes["judging"]).unlink(missing_ok=True)
    progress.say(f"written to {folder.path}")
    results: dict[str, Any] = json.loads(content)
    return results


def _updates(trained: Trained) -> str:
    """`teacher 300 of 300, student 900 of 900`, and how to go on if that is not all."""
    text = ", ".join(f"{phase} {n} of {trained.asked[phase]}" for phase, n in trained.steps.items())
    return text if trained.complete else f"{text} (incomplete: the same command continues)"


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
        "updates_asked": dict(trained.asked),
        "complete": trained.complete,
        "seconds": {phase: round(value, 1) for phase, value in seconds.items()},
        "versions": {name: version(name) for name in VERSIONED},
        "config": to_plain(config),
    }
