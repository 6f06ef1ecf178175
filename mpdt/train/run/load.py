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
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
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
from mpdt.train.adapt.align import AdaptationSet, returns_of_test_tasks
from mpdt.train.adapt.candidates import Candidates
from mpdt.train.fit.trained import Trained
from mpdt.train.run.build import build
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.folder import RunFolder, stored_settings
from mpdt.train.run.prepare import Prepared, prepare
from mpdt.train.run.results import read_results

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
    prepared = _prepare(folder, data)
    config, material = prepared.config, prepared.material
    row = material.dataset.task_row(task)
    own = row in material.train_rows and start is None
    start = start or "none"
    if not own and row not in material.test_rows:
        names = [material.dataset.tasks.names[known] for known in material.test_rows]
        raise unknown_name("test task", material.dataset.tasks.names[row], names, str(folder.path))
    trained = _weights(folder, prepared)
    config = msgspec.structs.replace(
        config,
        adapt=msgspec.structs.replace(config.adapt, starts=("none" if callable(start) else start,)),
        few_shot=msgspec.structs.replace(config.few_shot, qualities=(), demonstration=False),
    )
    candidates = Candidates(trained, config)
    if own:
        slot = material.train_rows.index(row)
        controller: Actor = candidates.own()
    else:
        slot = material.test_rows.index(row)
        if callable(start):
            controller = candidates.controller(*_adapted_by(start, config, trained))
        else:
            controller = next(iter(candidates)).controller
    return ActingPolicy(controller, material.family, slot)


def load_trained(run: Path | str, data: Path | str | None = None) -> Trained:
    """What training left in the folder of a run; trains nothing and writes nothing.

    Args:
        data: as in `load_policy`.
    Raises: as `load_policy`.
    """
    folder = RunFolder(Path(run))
    return _weights(folder, _prepare(folder, data))


def _adapted_by(
    adaptation: Adaptation, config: TrainConfig, trained: Trained
) -> tuple[Tensor, ReturnTable]:
    """Prompts (n, l, s) of all test tasks, and their returns. Raises: ShapeError; DataError."""
    material = trained.material
    family = material.family
    x = AdaptationSet(
        material.dataset, material.test_rows, config.adapt, config.sampler.window,
        phase_seed(config.seed, "adapt"), family.action_low, family.action_high,
    )  # fmt: skip
    returns = returns_of_test_tasks(trained.returns, config.adapt, x.presets)
    prompts = adaptation(trained.policy, trained.prompts, x, returns).detach()
    wanted = (len(material.test_rows), *trained.prompts.task_prompts().shape[1:])
    if prompts.shape != wanted:
        raise ShapeError("one prompt (l, s) per test task", where="load_policy: start",
                         expected=str(wanted), found=str(tuple(prompts.shape)))  # fmt: skip
    return prompts, returns


def _prepare(folder: RunFolder, data: Path | str | None) -> Prepared:
    return prepare(stored_settings(folder.path), _data_of(folder, data))


def _weights(folder: RunFolder, prepared: Prepared) -> Trained:
    """The learner of the run, filled from its file of weights."""
    learner = build(prepared, from_settings(prepared.config.backbone))
    header, tensors = load_weights(folder.weights, kind="mpdt", hashes=learner.hashes)
    learner.subject(learner.prompts).load(tensors)
    return learner.trained(msgspec.convert(header.settings["updates"], dict[str, int]))


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
