"""The policy of a run out of its weights: needs the data, and builds what training built.

Runs from before there were bundles act this way, and adaptations that are asked for later.
Nothing is written into the run's folder.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, get_args

import msgspec
from torch import Tensor

from mpdt.data.store.reader import parse_ref
from mpdt.errors import FormatError, MissingFileError, ShapeError, quoted, unknown_name
from mpdt.model.backbone import from_settings
from mpdt.model.policy import PromptPolicy
from mpdt.model.prompts import Start, TrainedPrompts
from mpdt.model.returns import ReturnTable
from mpdt.model.weights import load_weights
from mpdt.seeding import phase_seed
from mpdt.train.adapt.align import NOT_ADAPTED, AdaptationSet, returns_of_test_tasks
from mpdt.train.adapt.candidates import Candidates
from mpdt.train.bundle.acting import ActingPolicy
from mpdt.train.bundle.contents import (
    ActingPrompts,
    contents_of,
    own_prompts,
    prompts_of,
    without_backbone,
)
from mpdt.train.bundle.format import BundleConfig, Contents
from mpdt.train.bundle.read import is_bundle, read_contents
from mpdt.train.fit.trained import Trained
from mpdt.train.run.build import build
from mpdt.train.run.config import TrainConfig, to_plain
from mpdt.train.run.folder import RunFolder, stored_settings, stored_slice
from mpdt.train.run.older import as_stored
from mpdt.train.run.prepare import Prepared, prepare
from mpdt.train.run.results import read_results, trained_as

Adaptation = Callable[[PromptPolicy, TrainedPrompts, AdaptationSet, ReturnTable], Tensor]
"""An adaptation of your own: policy, trained prompts, X and returns of the n test tasks ->
prompts (n, l, s) of these tasks. What it is given is frozen by convention; copy what you tune."""


def policy_of_run(
    folder: RunFolder, task: str | int | None, data: Path | str | None,
    start: str | Adaptation | None,
) -> ActingPolicy:  # fmt: skip
    """The policy of a run for one task of its data; adapts where the start asks for that.

    Args, Raises: as `load_policy`.
    """
    prepared = _prepare(folder, data)
    config, material = prepared.config, prepared.material
    names = material.dataset.tasks.names
    row = material.dataset.task_row(material.train_rows[0] if task is None else task)
    own = row in material.train_rows and start is None
    if not own and row not in material.test_rows:
        known = [names[test] for test in material.test_rows]
        raise unknown_name("test task", names[row], known, str(folder.path))
    trained = _weights(folder, prepared)
    if own:
        chosen = own_prompts(trained)
    elif callable(start):
        chosen = ActingPrompts("own adaptation", material.test_rows,
                               *_adapted_by(start, config, trained))  # fmt: skip
    else:
        chosen = _started(start or NOT_ADAPTED, config, trained, str(folder.path))
    assert chosen.prompts is not None
    return ActingPolicy(
        trained.policy, chosen.prompts, chosen.returns, material.family,
        [names[one] for one in chosen.rows], names[row], config.sampler.window,
    )  # fmt: skip


def bundle_of_run(folder: RunFolder, data: Path | str | None, inside: bool) -> Contents:
    """What the bundle of a finished run holds: out of the one it left, or adapted again.

    Args:
        data: as in `load_policy`; not needed where the run left its policy.
        inside: with the language model's blocks.
    Raises: as `load_policy`, `contents_of`; FormatError, MissingFileError for a damaged bundle.
    """
    if is_bundle(folder.policy):
        try:
            contents = read_contents(folder.policy)
        except (FormatError, MissingFileError) as error:
            raise error.with_hint(_without(folder.policy)) from error
        return contents if inside else without_backbone(contents)
    prepared = _prepare(folder, data)
    trained, rows = _weights(folder, prepared), prepared.material.test_rows
    acting = [own_prompts(trained)]
    if rows:
        candidates = Candidates(trained, prepared.config)
        acting += [prompts_of(one, rows, candidates.returns) for one in candidates]
    return contents_of(trained, acting, to_plain(prepared.config), folder.path.name,
                       prepared.identity.hashes, inside)  # fmt: skip


def check_same_run(config: BundleConfig, results: Mapping[str, Any], policy: Path) -> None:
    """Raises: FormatError where a card would tell of another training than the bundle's."""
    wanted, found = trained_as(results), config.training.identity.get("training", "")
    if wanted and found != wanted:
        raise FormatError("the bundle of another run", where=str(policy), expected=wanted[:12],
                          found=found[:12], hint=_without(policy))  # fmt: skip


def _without(policy: Path) -> str:
    return f"move {quoted(policy)} away; then it is made of the weights"


def load_trained(run: Path | str, data: Path | str | None = None) -> Trained:
    """What training left in the folder of a run; trains nothing and writes nothing.

    Args:
        data: as in `load_policy`.
    Raises: as `load_policy`.
    """
    folder = RunFolder(Path(run))
    return _weights(folder, _prepare(folder, data))


def _started(start: str, config: TrainConfig, trained: Trained, where: str) -> ActingPrompts:
    """Prompts of all test tasks from a start of adaptation. Raises: UsageError for another word."""
    known = get_args(Start)
    if start not in known:
        raise unknown_name("start", start, known, where)
    one = msgspec.structs.replace(
        config,
        adapt=msgspec.structs.replace(config.adapt, starts=(start,)),
        few_shot=msgspec.structs.replace(config.few_shot, qualities=(), demonstration=False),
    )
    candidates = Candidates(trained, one)
    return prompts_of(next(iter(candidates)), trained.material.test_rows, candidates.returns)


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
    prepared = prepare(stored_settings(folder.path), _data_of(folder, data))
    return as_stored(prepared, folder)


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
        file = str(read_results(folder.path).get("data", {}).get("file"))
        places = (Path(), folder.path.parent, folder.path.parent.parent)
        files = file.split(",") if not any((place / file).is_file() for place in places) else [file]
        found = [
            ",".join(str(place / file) for file in files)
            for place in places
            if all((place / file).is_file() for file in files)
        ]
        if not found:
            raise MissingFileError("the file of this run is not here", where=file,
                                   hint="say where: load_policy(..., data=FILE)")  # fmt: skip
        path = Path(found[0])
    name = name or stored_slice(folder)
    return f"{path}:{name}" if name else str(path)
