"""What makes two runs the same: everything they read, in two parts.

    training   settings of training     + episodes, their ids, statistics of the observations
    judging    name, adapt, few_shot,   + TTA set, presets, references, simulator options
               statistics, evaluation

Weights are bound to the training part alone, so another judging part judges them anew. A
setting belongs to training unless it is named here, which at worst trains once too often.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.store.dataset import Dataset
from mpdt.data.store.ttaset import find_tta_set
from mpdt.train.adapt.trials.settings import BEFORE_THERE_WAS_A_CHOICE
from mpdt.train.fit.data import Material
from mpdt.train.run.config import TrainConfig, from_plain, to_plain

JUDGING = ("method", "adapt", "few_shot", "statistics", "evaluation")


@dataclass(frozen=True)
class Identity:
    """Facts as JSON values: settings by their names, hashes of arrays under `data`."""

    training: dict[str, Any]
    judging: dict[str, Any]

    @property
    def hashes(self) -> dict[str, str]:
        """SHA-256 of each part; what weights and results carry."""
        return {"training": _hash_facts(self.training), "judging": _hash_facts(self.judging)}


def identify(config: TrainConfig, plain: Mapping[str, Any], material: Material) -> Identity:
    """The identity of a run.

    Args:
        plain: `plain_settings(config)`.
    Raises: as `find_tta_set`, where the run needs that set.
    """
    settings = dict(plain)
    judging = {name: settings.pop(name) for name in JUDGING}
    settings["quality"] = material.quality
    facts = (
        settings | {"data": _trained_on(material)},
        judging | {"data": _judged_on(config, material)},
    )
    # As config.json gives them back: lists for tuples.
    training, judging = json.loads(json.dumps(facts))
    return Identity(training, judging)


def plain_settings(config: TrainConfig) -> dict[str, Any]:
    """What of a configuration counts, as JSON values."""
    # The round trip makes 1 and 1.0 of a float setting one.
    config = from_plain(to_plain(config))
    settings = to_plain(config)
    # What plain hardware does belongs to runs from before there was a choice, too.
    if settings["hardware"] == to_plain(TrainConfig())["hardware"]:
        del settings["hardware"]
    # As in runs from before there was a choice.
    _drop(settings, {"began_from": None, "validation": None, "patience": 0})
    settings["adapt"]["infer"] = config.adapt.infer.facts
    if "trials" not in settings["adapt"]["starts"]:  # nor what nobody asked for
        del settings["adapt"]["trials"]
    else:
        _drop(settings["adapt"]["trials"], BEFORE_THERE_WAS_A_CHOICE)
    return settings


def from_record(plain: Mapping[str, Any]) -> TrainConfig:
    """The configuration of settings on record; what `plain_settings` left out of trials, and what
    older ones do not name, is as it was then, which is not what is the default now.

    Raises: as `from_plain`.
    """
    adapt = plain.get("adapt")
    if (
        isinstance(adapt, dict)
        and isinstance(adapt.get("trials"), dict)
        and "trials" in adapt.get("starts", ())
    ):
        trials = BEFORE_THERE_WAS_A_CHOICE | adapt["trials"]
        plain = {**plain, "adapt": {**adapt, "trials": trials}}
    return from_plain(dict(plain))


def _drop(settings: dict[str, Any], plain: Mapping[str, Any]) -> None:
    """What is as it was before it could be chosen."""
    for name, value in plain.items():
        if settings[name] == value:
            del settings[name]


def files_of(dataset: Dataset) -> dict[str, Any]:
    """Under `files`, each of several files that were read as one; nothing for a single file."""
    files = [
        {"name": part.name, "version": part.version, "content_hash": part.content_hash}
        for part in dataset.parts
    ]
    return {"files": files} if files else {}


def _trained_on(material: Material) -> dict[str, Any]:
    dataset, stats = material.dataset, material.dataset.stats["observations"]
    return {
        "family": dataset.family,
        "content_hash": dataset.content_hash,
        "slice": material.slice,
        "episodes": _hash_arrays(material.episode_ids[row] for row in material.train_rows),
        "statistics": _hash_arrays([stats["mean"], stats["std"]]),
        **_validated_on(material),
        **files_of(dataset),
    }


def _validated_on(material: Material) -> dict[str, str]:
    rows = sorted(material.validation_ids)
    return {"validation": _hash_arrays(material.validation_ids[r] for r in rows)} if rows else {}


def _judged_on(config: TrainConfig, material: Material) -> dict[str, Any]:
    dataset, tasks, x = material.dataset, material.dataset.tasks, {}
    if config.adapt.needs_set and material.test_rows:
        chosen = find_tta_set(dataset, config.adapt.set, material.test_rows,
                              config.adapt.episodes)  # fmt: skip
        presets = _hash_arrays([chosen.task, chosen.preset_return])
        x = {"content_hash": chosen.content_hash, "presets": presets}
    return {
        "test_tasks": [tasks.names[row] for row in material.test_rows],
        "tta": x,
        "references": hashlib.sha256(repr(tasks.references).encode()).hexdigest(),
        "options": dict(material.options),
        "horizon": material.horizon,
        # Judged again where the simulator is.
        **({} if material.family.simulates else {"simulates": False}),
    }


def _hash_facts(facts: dict[str, Any]) -> str:
    text = json.dumps(facts, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _hash_arrays(arrays: Iterable[NDArray[Any]]) -> str:
    state = hashlib.sha256()
    for array in arrays:
        state.update(f"{array.dtype.str}{array.shape}".encode())
        state.update(np.ascontiguousarray(array).tobytes())
    return state.hexdigest()
