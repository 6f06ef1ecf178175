"""One run before anything is built: its settings, its data open, and what makes it this run.

Made once. A study looks at it, the pipeline runs it, loading compares weights with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from mpdt.data.sim.simulators import not_installed
from mpdt.errors import UsageError
from mpdt.train.fit.data import Material, load_material
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.identity import Identity, identify, plain_settings

_MOST_WHOLE, _MOST_RATE = 2**63 - 1, 1e30
"""Whole numbers that results.json can hold; optimisers divide rates, in float32."""
_MOST_AT_ONCE: Mapping[str, int] = {
    "sampler.per_task": 100_000, "sampler.tasks_per_update": 100_000, "sampler.window": 100_000,
    "prompts.length": 100_000, "prompts.rank": 100_000, "head.hidden": 100_000,
    "adapt.windows": 100_000, "adapt.infer.hidden": 100_000, "evaluation.max_rows": 1_000_000,
    "adapt.trials.world.hidden": 100_000, "adapt.trials.world.members": 1_000,
    "adapt.trials.world.batch": 1_000_000, "adapt.trials.planner.samples": 1_000_000,
    "adapt.trials.planner.horizon": 100_000, "adapt.trials.planner.echoes": 10_000,
}  # fmt: skip
"""What is held in memory at once, far beyond what anybody asks for: it stops slips of the keyboard
before the system does. What is below may still be more than a machine has."""


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

    Raises: as `load_material`, `identify` and `check_sizes`; DataError where judging needs random
        episodes of the training tasks and the file holds none; SimulatorError where trials are
        asked for and the simulator is not here.
    """
    plain = plain_settings(config)
    check_sizes(plain)
    material = load_material(ref, config.quality, config.validation)
    if config.adapt.tries and not material.family.simulates:
        raise not_installed(material.family)
    random = config.statistics.source == "random" and config.adapt.aligns
    if material.test_rows and (random or config.adapt.explains):
        material.random_ids()
    return Prepared(config, plain, ref, material, identify(config, plain, material))


def check_sizes(plain: Mapping[str, Any]) -> None:
    """Raises: UsageError for a number of the settings (JSON values) that is too large to be meant.
    What is too small, each group of settings says itself."""
    for name, value in _numbers(plain):
        most = _MOST_WHOLE if isinstance(value, int) else _MOST_RATE
        most = _MOST_AT_ONCE.get(name, most)
        if value > most:
            text = f"{most:,}" if isinstance(most, int) else f"{most:g}"
            raise UsageError("setting out of range", where=name, expected=f"at most {text}",
                             found=str(value))  # fmt: skip


def _numbers(plain: Any, name: str = "") -> Iterator[tuple[str, int | float]]:
    if isinstance(plain, Mapping):
        for key, value in plain.items():
            yield from _numbers(value, f"{name}.{key}" if name else str(key))
    elif isinstance(plain, list | tuple):
        for value in plain:
            yield from _numbers(value, name)
    elif isinstance(plain, int | float) and not isinstance(plain, bool):
        yield name, plain
