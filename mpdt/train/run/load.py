"""A trained policy in a plain gymnasium loop.

    policy = mpdt.load_policy("runs/cheetah_dir-base", task="forward")
    observation, reward, over = env.reset(seed=0)[0], None, False
    while not over:
        observation, reward, terminated, truncated, _ = env.step(policy.act(observation, reward))
        over = terminated or truncated

The same numbers as `evaluate` with one row. Nothing is written into the run's folder.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from mpdt.data.sim.actors import Actor, Rows
from mpdt.data.spec.tasks import Family
from mpdt.data.store.reader import parse_ref
from mpdt.errors import MissingFileError, ShapeError, unknown_name
from mpdt.model.backbone import from_settings
from mpdt.model.policy import PromptPolicy
from mpdt.model.prompts import Start, TrainedPrompts
from mpdt.model.returns import ReturnTable
from mpdt.model.weights import load_weights
from mpdt.seeding import phase_seed
from mpdt.train.adapt.align import AdaptationSet, unseen_returns
from mpdt.train.adapt.candidates import UnseenTasks
from mpdt.train.fit.checkpoint import Subject
from mpdt.train.fit.data import load_material
from mpdt.train.fit.loop import make_optimizer
from mpdt.train.run.folder import RunFolder, stored_settings
from mpdt.train.run.identity import identify
from mpdt.train.run.progress import Progress
from mpdt.train.run.show import read_results
from mpdt.train.run.stop import StopRequest
from mpdt.train.run.trainer import Trained, Trainer

Adaptation = Callable[[PromptPolicy, TrainedPrompts, AdaptationSet, ReturnTable], Tensor]
"""An adaptation of your own: policy, trained prompts, X and returns of the n test tasks ->
prompts (n, l, s) of these tasks. What it is given is frozen by convention; copy what you tune."""


class ActingPolicy:
    """One task's policy, one episode at a time.

    Args:
        controller: of a single row.
        slot: the task's number among those the controller knows.
    """

    def __init__(self, controller: Actor, family: Family, slot: int) -> None:
        self.family = family
        self._controller, self._slot, self._step = controller, slot, 0

    def act(self, observation: ArrayLike, reward: float | None = None) -> NDArray[np.float32]:
        """The action (A,) for an observation (D,) of the task's environment.

        Args:
            reward: what the action before was paid. None begins a new episode: the policy
                forgets what it has seen.
        """
        if reward is None:
            self._controller.begin(Rows((), tasks=np.array([self._slot])))
            self._step = 0
        paid = None if reward is None else np.array([reward], np.float32)
        shown = np.array([observation], np.float32)
        shown[:, list(self.family.hidden_columns)] = 0  # as in the data
        wished = self._controller.act(self._step, shown, paid)[0]
        self._step += 1
        action: NDArray[np.float32] = wished.clip(self.family.action_low, self.family.action_high)
        return action


def load_policy(
    run: Path | str, task: str | int, *, data: Path | str | None = None,
    start: Start | Adaptation | None = None,
) -> ActingPolicy:  # fmt: skip
    """The policy of a run for one task of its data.

    Args:
        run: the run's folder, such as runs/cheetah_dir-base.
        task: name or row. One that was trained on acts behind its own prompt.
        data: FILE or FILE:slice it was trained on; None = the file of that name in the working
            folder or beside the folder of runs.
        start: adapt to `task`, a test task, from there; "none" = P_c and the mean of all P_k.
            None = the own prompt, or "none" for a task that was not trained on. A function is
            an adaptation of your own, see `Adaptation`.
    Raises: MissingFileError; UsageError for a task without prompt; TrainingError or FormatError
        for weights of other data or settings; as `open_dataset`.
    """
    folder = RunFolder(Path(run))
    config = stored_settings(folder.path)
    material = load_material(_data_of(folder, data), config.quality)
    row = material.dataset.task_row(task)
    own = row in material.train_rows and start is None
    start = start or "none"
    if not own and row not in material.test_rows:
        names = [material.dataset.tasks.names[known] for known in material.test_rows]
        raise unknown_name("test task", material.dataset.tasks.names[row], names, str(folder.path))
    identity = identify(config, material).hashes["training"]
    # Judging settings are not part of what the weights are bound to.
    config = msgspec.structs.replace(
        config,
        adapt=msgspec.structs.replace(config.adapt, starts=("none" if callable(start) else start,)),
        few_shot=msgspec.structs.replace(config.few_shot, qualities=(), demonstration=False),
    )
    with tempfile.TemporaryDirectory() as scratch:  # adaptation keeps a log
        trainer = Trainer(
            material, config, from_settings(config.backbone), RunFolder(Path(scratch)),
            Progress(quiet=True), StopRequest(), run_hash=identity,
        )  # fmt: skip
        trained = _load(trainer, folder.weights)
        unseen = UnseenTasks(trainer, trained)
        if own:
            slot = material.train_rows.index(row)
            with torch.no_grad():
                prompts = trained.prompts.task_prompts()
            controller: Actor = unseen.controller(prompts, trained.returns)
        else:
            slot = material.test_rows.index(row)
            if callable(start):
                controller = unseen.controller(*_adapted_by(start, trainer, trained))
            else:
                controller = next(unseen.candidates()).controller
    return ActingPolicy(controller, material.family, slot)


def _adapted_by(
    adaptation: Adaptation, trainer: Trainer, trained: Trained
) -> tuple[Tensor, ReturnTable]:
    """Prompts (n, l, s) of all test tasks, and their returns. Raises: ShapeError; DataError."""
    config, material = trainer.config, trainer.material
    family = material.family
    x = AdaptationSet(
        material.dataset, material.test_rows, config.adapt, config.sampler.window,
        phase_seed(config.seed, "adapt"), family.action_low, family.action_high,
    )  # fmt: skip
    returns = unseen_returns(trained.returns, config.adapt, x.presets)
    prompts = adaptation(trained.policy, trained.prompts, x, returns).detach()
    wanted = (len(material.test_rows), *trained.prompts.task_prompts().shape[1:])
    if prompts.shape != wanted:
        raise ShapeError("one prompt (l, s) per test task", where="load_policy: start",
                         expected=str(wanted), found=str(tuple(prompts.shape)))  # fmt: skip
    return prompts, returns


def _load(trainer: Trainer, weights: Path) -> Trained:
    """What training left on the disk; trains nothing, touches no log."""
    trainer.prepare()
    optimizer = make_optimizer(trainer.policy, trainer.prompts, trainer.config.optimiser)
    hashes = {"run": trainer.run_hash, "backbone": trainer.backbone.fingerprint}
    _, tensors = load_weights(weights, kind="mpdt", hashes=hashes)
    Subject(trainer.policy, trainer.prompts, optimizer).load(tensors)
    return Trained(trainer.policy, trainer.prompts, trainer.returns, trainer.asked, trainer.asked)


def _data_of(folder: RunFolder, data: Path | str | None) -> str:
    """FILE or FILE:slice. Raises: MissingFileError where nobody says which file."""
    name: str | None = None
    if data is not None:
        path, name = parse_ref(str(data))
    else:
        file = str(read_results(folder.path)["data"]["file"])
        places = (Path(), folder.path.parent, folder.path.parent.parent)
        found = [place / file for place in places if (place / file).is_file()]
        if not found:
            raise MissingFileError("the file of this run is not here", where=file,
                                   hint="say where: load_policy(..., data=FILE)")  # fmt: skip
        path = found[0]
    stored = json.loads(folder.config.read_text(encoding="utf-8"))["training"]["data"]
    name = name or stored["slice"]
    return f"{path}:{name}" if name else str(path)
