"""The whole of `mpdt-train --data FILE`: train, judge, write down.

prepared -> train -> weights.safetensors
         -> layer statistics -> adapted prompts of the test tasks
         -> closed-loop evaluation -> results.json, report.md, policy/
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from mpdt.data.sim.simulators import not_installed
from mpdt.data.store.proof import BackgroundProof
from mpdt.disk import disk, sweep, write_bytes
from mpdt.draw.table import markdown_page
from mpdt.errors import BackboneError, MissingFileError, UsageError, quoted
from mpdt.model.backbone import from_settings
from mpdt.train.bundle.card import card_of
from mpdt.train.bundle.contents import ActingPrompts, contents_of
from mpdt.train.bundle.write import remove_bundle, write_bundle
from mpdt.train.evaluate.score import Score, encode_results
from mpdt.train.evaluate.tables import NORMALISED, build_tables
from mpdt.train.fit.data import Material
from mpdt.train.fit.group import Group
from mpdt.train.fit.trained import Trained
from mpdt.train.fit.validation import PHASE
from mpdt.train.run.begin import Beginning
from mpdt.train.run.build import build
from mpdt.train.run.config import to_plain
from mpdt.train.run.folder import RunFolder, claimed, inspect, write_config
from mpdt.train.run.follower import Follower
from mpdt.train.run.judge import Judge
from mpdt.train.run.keep import Keeper
from mpdt.train.run.older import as_stored
from mpdt.train.run.prepare import Prepared
from mpdt.train.run.progress import Progress
from mpdt.train.run.results import find_results, results_header, set_aside
from mpdt.train.run.spent import Spent
from mpdt.train.run.trainer import Trainer

How = Literal["continue", "restart", "judge"]
"""Go on where the folder is, begin anew, or judge what is there and train nothing."""


def run_pipeline(
    prepared: Prepared,
    folder: RunFolder,
    progress: Progress,
    how: How = "continue",
    time_limit_s: float = 0.0,
    keep: Path | None = None,
    beginning: Beginning | None = None,
    follower: Follower | None = None,
) -> dict[str, Any]:
    """Do, continue or look up one run; returns the content of its results.json.

    Args:
        beginning: where its numbers begin, if not anew; needed until it is trained.
        follower: told of it while it goes; of a finished run, what it has not heard.
        keep: where the episodes of its judgement go as data, see `keep.py`; judges in any case.
    Raises: Stopped after a signal, with everything saved that can be; MpdtError for what the
        user can mend, before anything is written or trained where that can be known.
    """
    if not time_limit_s >= 0:
        raise UsageError("setting out of range", where="--time-limit-s",
                         expected="at least 0", found=str(time_limit_s))  # fmt: skip
    restart = how == "restart"
    if not restart:
        prepared = as_stored(prepared, folder)
    config, identity = prepared.config, prepared.identity
    group = Group.join()
    if group.size > 1 and config.inputs.return_dropout:
        raise UsageError("return dropout is drawn for whole batches, not for a process's share",
                         where="inputs.return_dropout", expected="0 with torchrun",
                         found=str(config.inputs.return_dropout))  # fmt: skip
    if group.rank > 0:
        # Every process keeps checkpoints of its own; what is judged and kept is the first one's.
        folder = RunFolder(folder.path.with_name(f"{folder.path.name}.rank-{group.rank}"))
    progress.say(_describe(prepared.material))
    keeper = None
    if keep is not None:
        if not prepared.material.family.simulates:
            raise not_installed(prepared.material.family)
        facts = {"run": identity.hashes["training"]}
        keeper = Keeper(keep, folder.path.name, facts, progress.say)
    done = None if restart or keeper else find_results(folder.path, identity.hashes)
    # Only the first process has results; none may go on while another is gone.
    if group.any([done is not None])[0]:
        group.leave()
        progress.say(f"this run is done: {folder.path} (again: --restart)")
        sweep(folder.path)
        if done is not None:  # a kill just before the end leaves it there a second time
            with disk(folder.path):
                folder.judged(identity.hashes["judging"]).unlink(missing_ok=True)
        if done is not None and follower is not None:
            with claimed(folder, identity, restart=False):
                follower.begin(folder, prepared)
                follower.judged(done)
        return done or {}
    inspect(folder, identity, restart, judges=how == "judge")
    if how == "judge" and not folder.weights.exists():
        raise MissingFileError("no trained weights in this run", where=str(folder.path),
                               hint=f"mpdt-train --data {quoted(prepared.ref)} "
                               f"--name {quoted(folder.path.name)}")  # fmt: skip
    progress.stop.check()
    torch.set_num_threads(config.threads or len(os.sched_getaffinity(0)))
    backbone = from_settings(config.backbone)
    progress.say(
        f"backbone {backbone.name}, {backbone.num_layers} blocks of width {backbone.width}, "
        f"{str(backbone.dtype).removeprefix('torch.')}, weights {backbone.fingerprint[:12]}"
    )
    # Whatever can be refused has been refused after this, and nothing was written yet.
    learner = build(prepared, backbone)
    if beginning is not None:
        for line in beginning.fill(learner):
            progress.say(line)
    trainer = Trainer(learner, folder, progress, time_limit_s, group, filled=beginning is not None)
    progress.stop.check()
    with (
        claimed(folder, identity, restart),
        _proving(prepared, progress) as trainer.proof,
    ):
        if group.rank > 0:
            trainer.train()
            group.leave()
            return {}
        if follower is not None:
            follower.begin(folder, prepared)
            trainer.follower = follower
        return _train_and_judge(trainer, keeper)


@contextmanager
def _proving(prepared: Prepared, progress: Progress) -> Iterator[BackgroundProof]:
    """Compare what the run reads with its digests, beside the work; looked at with every update."""
    config, material = prepared.config, prepared.material
    mixes = config.mixing.share > 0
    read = list(material.episode_ids.values())
    learns = config.adapt.infers or config.adapt.tries or mixes
    if learns or config.statistics.source == "random":
        read.append(material.dataset.select(task=list(material.train_rows), quality="random"))
    if config.few_shot.qualities or config.few_shot.demonstration:
        read.append(material.dataset.select(task=list(material.test_rows)))
    sets = [config.adapt.set] if config.adapt.needs_set else []
    proof = BackgroundProof(material.dataset, np.unique(np.concatenate(read)), sets)
    progress.also = proof.check
    try:
        yield proof
    finally:
        proof.stop()
        progress.also = None


def _train_and_judge(trainer: Trainer, keeper: Keeper | None = None) -> dict[str, Any]:
    """The content of results.json, written."""
    prepared, folder, progress = trainer.learner.prepared, trainer.folder, trainer.progress
    name = folder.path.name
    trained = trainer.train()
    trained_s = Spent(folder).training_s
    trainer.group.leave()
    if not trained.complete:
        progress.say(f"training ended by --time-limit-s: {_updates(trained)}")
    began_s = time.monotonic()
    if not prepared.material.family.simulates:
        for line in _not_judged(trainer):
            progress.say(line)
    told: list[Mapping[str, Any]] = []
    judge = Judge(trained, prepared.config, progress, told, keeper, folder.trials)
    scores = judge.scores()
    judging_s = time.monotonic() - began_s - judge.adaptation_s
    if trainer.proof is not None:
        trainer.proof.finish()  # also where nothing was left to train
    parts = {"training": trained_s, "adaptation": judge.adaptation_s, "judging": judging_s}
    seconds = {**parts, "all": sum(parts.values())}
    header = results_header(name, prepared, trained, seconds)
    content = encode_results(header, scores)
    backbone = trained.policy.backbone
    facts = {
        "name": name,
        "data": _describe(prepared.material),
        "backbone": f"{backbone.name}, {backbone.num_layers} blocks, {backbone.fingerprint}",
        "trained numbers": f"{trained.num_trainables:,}",
        "updates": _updates(trained),
    }
    # results.json goes first and comes last: it is what marks a run as done. Until then the lines
    # of the judgement before stay beside it.
    with disk(folder.results):
        set_aside(folder)
    folder.log.put(trainer.log_bytes, told)
    write_config(folder, prepared.identity)
    remove_bundle(folder.policy)
    write_bytes(folder.report, markdown_page(facts, build_tables(scores), NORMALISED).encode())
    _leave_policy(trainer, trained, judge.acting, scores)
    write_bytes(folder.results, content)
    with disk(folder.path):
        folder.judged(prepared.identity.hashes["judging"]).unlink(missing_ok=True)
    progress.say(f"written to {folder.path}")
    results: dict[str, Any] = json.loads(content)
    if trained.complete:
        trainer.follower.judged(results)
    return results


def _not_judged(trainer: Trainer) -> Iterator[str]:
    material = trainer.learner.prepared.material
    error = not_installed(material.family)
    yield f"not judged: {error.what}; {error.hint}"
    looks = [r["action_error"] for r in trainer.folder.log.records() if r["phase"] == PHASE]
    if looks:
        yield f"action error on validation episodes: {looks[-1]:.4g}"
    elif not material.validation_ids:
        yield "mpdt-data split FILE --validation 0.1, and --validation NAME here: an action error"


def _leave_policy(
    trainer: Trainer, trained: Trained, acting: Sequence[ActingPrompts], scores: Sequence[Score]
) -> None:
    """The bundle, with the language model's blocks where they can be carried."""
    prepared, folder = trainer.learner.prepared, trainer.folder
    facts = (to_plain(prepared.config), folder.path.name, prepared.identity.hashes)
    try:
        contents = contents_of(trained, acting, *facts)
    except BackboneError as error:
        trainer.progress.say(f"policy/ is without the language model: {error}")
        if not trained.policy.backbone.frozen:
            return
        contents = contents_of(trained, acting, *facts, with_backbone=False)
    write_bundle(folder.policy, contents, card_of(contents.config, scores))


def _updates(trained: Trained) -> str:
    """`teacher 300 of 300, student 900 of 900`, and how to go on if that is not all."""
    text = ", ".join(f"{phase} {n} of {trained.asked[phase]}" for phase, n in trained.steps.items())
    return text if trained.complete else f"{text} (incomplete: the same command continues)"


def _describe(material: Material) -> str:
    dataset = material.dataset
    episodes = sum(len(ids) for ids in material.episode_ids.values())
    part = f":{material.slice}" if material.slice else ""
    return (
        f"{dataset.title}{part} ({dataset.name} {dataset.version}), content "
        f"{dataset.content_hash}, {material.quality}: {episodes} episodes of "
        f"{len(material.train_rows)} training tasks, {len(material.test_rows)} test tasks"
    )
