"""One run before anything is built: its settings, its data open, and what makes it this run.

Made once. A study looks at it, the pipeline runs it, loading compares weights with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpdt.data.sim.simulators import not_installed
from mpdt.train.fit.data import Material, load_material
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.identity import Identity, identify, plain_settings


@dataclass(frozen=True)
class Prepared:
    """What a run reads.

    Attributes:
        plain: what of the settings counts, as JSON values.
        ref: FILE or FILE:slice, as it was given.
    """

    config: TrainConfig
    plain: dict[str, Any]
    ref: str
    material: Material
    identity: Identity


def prepare(config: TrainConfig, ref: str) -> Prepared:
    """Open the data and find out what the run is; builds and writes nothing.

    Raises: as `load_material` and `identify`; DataError where judging needs random episodes of
        the training tasks and the file holds none; SimulatorError where trials are asked for and
        the simulator is not here.
    """
    plain = plain_settings(config)
    material = load_material(ref, config.quality, config.validation)
    if config.adapt.tries and not material.family.simulates:
        raise not_installed(material.family)
    random = config.statistics.source == "random" and config.adapt.aligns
    if material.test_rows and (random or config.adapt.explains):
        material.random_ids()
    return Prepared(config, plain, ref, material, identify(config, plain, material))
