"""How the behaviour network of a family is trained: settings, and what is refused of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields

from mpdt.errors import nearest


@dataclass(frozen=True)
class PretrainSettings:
    """PPO settings of one family. Lengths in environment steps unless named otherwise."""

    steps: int
    rows: int = 256
    steps_per_update: int = 50
    minibatch: int = 3200
    epochs: int = 6
    learning_rate: float = 5e-4
    hidden: int = 128
    discount: float = 0.99
    gae_lambda: float = 0.95
    entropy: float = 0.0
    log_std_init: float = -0.5
    max_kl: float = 0.02
    snapshots: int = 100
    threads: int = 2
    num_rungs: int = 20
    judge_episodes: int = 16
    judge_noise: float = 0.1
    early: int = 1
    """Snapshots in the time of the first one."""


OWN_STEPS = 1_000_000
"""Of a family that does not say how long to train."""
_ANY = ("log_std_init", "entropy", "judge_noise")
_WHOLE = tuple(one.name for one in fields(PretrainSettings) if one.type == "int")
_LEAST = {"num_rungs": 2, "snapshots": 2}
_MOST = {"steps": 10**12, "rows": 100_000, "hidden": 65_536, "snapshots": 100_000, "threads": 1_024}


def described(settings: PretrainSettings) -> dict[str, float]:
    """As records and checkpoints tell it: what came later is left out where nobody asked."""
    plain = asdict(settings)
    if settings.early == 1:
        del plain["early"]
    return plain


def own_settings(said: Mapping[str, float]) -> PretrainSettings:
    """Of a family of one's own: what it says over the defaults."""
    return PretrainSettings(**({"steps": OWN_STEPS} | dict(said)))  # type: ignore[arg-type]


def settings_problems(said: object) -> Iterator[str]:
    """What is wrong with a family's `pretrain`, one line each."""
    if not isinstance(said, Mapping):
        yield f"pretrain: settings by name, found {type(said).__name__}"
        return
    known = [one.name for one in fields(PretrainSettings)]
    for key, number in said.items():
        if key not in known:
            yield f"pretrain: unknown key '{key}' {nearest(str(key), known)}".rstrip()
            continue
        whole = key in _WHOLE
        if type(number) not in ((int,) if whole else (int, float)) or not math.isfinite(number):
            yield f"pretrain: {key} is a {'whole ' * whole}number, found {number!r}"
        elif key not in _ANY and number <= 0:
            yield f"pretrain: {key} is above 0, found {number!r}"
        elif number < _LEAST.get(key, number):
            yield f"pretrain: {key} is at least {_LEAST[key]}, found {number!r}"
        elif number > _MOST.get(key, number):
            yield f"pretrain: {key} is at most {_MOST[key]:,}, found {number!r}"
