"""How the behaviour network of a family is trained: settings, and what is refused of them.

pretrain: {steps: 600000, rows: 50}             PPO, which learns from many rows at once
pretrain: {algorithm: sac, steps: 60000}        SAC, which learns from all that it has seen
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

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


@dataclass(frozen=True)
class SacSettings:
    """SAC settings of one family. Lengths in environment steps unless named otherwise.

    Args:
        steps_per_update: of every row, before each learning.
        gradient_steps: minibatches learnt from each time.
        minibatch: transitions.
        tau: share of the critic that its slow copy takes over at every gradient step.
        entropy: weight of the entropy in the return; 0 = learnt.
        buffer: transitions kept, and sampled from.
        warmup: uniform actions before the first learning.
        early: snapshots in the time of the first one.
    """

    steps: int
    rows: int = 20
    steps_per_update: int = 1
    gradient_steps: int = 2
    minibatch: int = 256
    learning_rate: float = 1e-3
    hidden: int = 64
    discount: float = 0.98
    tau: float = 0.005
    entropy: float = 0.0
    buffer: int = 200_000
    warmup: int = 1_000
    snapshots: int = 50
    threads: int = 1
    num_rungs: int = 20
    judge_episodes: int = 4
    judge_noise: float = 0.1
    early: int = 1
    algorithm: str = "sac"


Settings = PretrainSettings | SacSettings

ALGORITHMS: dict[str, type[PretrainSettings] | type[SacSettings]] = {
    "ppo": PretrainSettings,
    "sac": SacSettings,
}
OWN_STEPS = {"ppo": 1_000_000, "sac": 100_000}
"""Of a family that does not say how long to train."""
_KEYS = {
    name: tuple(one.name for one in fields(kind) if one.name != "algorithm")
    for name, kind in ALGORITHMS.items()
}
_ANY = ("log_std_init", "entropy", "judge_noise")
_WHOLE = {one.name for kind in ALGORITHMS.values() for one in fields(kind) if one.type == "int"}
_LEAST = {"num_rungs": 2, "snapshots": 2}
_MOST = {"steps": 10**12, "rows": 100_000, "hidden": 65_536, "snapshots": 100_000, "threads": 1_024,
         "tau": 1, "discount": 1, "gae_lambda": 1, "buffer": 10**9}  # fmt: skip


def described(settings: Settings) -> dict[str, Any]:
    """As records and checkpoints tell it: what came later is left out where nobody asked."""
    plain = asdict(settings)
    if settings.early == 1:
        del plain["early"]
    return plain


def own_settings(said: Mapping[str, Any]) -> Settings:
    """Of a family of one's own: what it says over the defaults."""
    plain = dict(said)
    algorithm = plain.pop("algorithm", "ppo")
    return ALGORITHMS[algorithm](**({"steps": OWN_STEPS[algorithm]} | plain))


def settings_over(module: Mapping[str, Any], entry: Mapping[str, Any]) -> dict[str, Any]:
    """What an entry says over what the family's module does; of another algorithm, it alone."""
    if entry.get("algorithm", module.get("algorithm", "ppo")) != module.get("algorithm", "ppo"):
        return dict(entry)
    return dict(module) | dict(entry)


def settings_problems(said: object, *, whole: bool = True) -> Iterator[str]:
    """What is wrong with a family's `pretrain`, one line each.

    Args:
        whole: nothing else says more; otherwise a key may be of any algorithm that is not named.
    """
    if not isinstance(said, Mapping):
        yield f"pretrain: settings by name, found {type(said).__name__}"
        return
    algorithm = said.get("algorithm", "ppo" if whole else None)
    is_named = whole or "algorithm" in said
    if is_named and not (isinstance(algorithm, str) and algorithm in ALGORITHMS):
        near = nearest(str(algorithm), ALGORITHMS)
        known = " or ".join(ALGORITHMS)
        yield f"pretrain: unknown algorithm {algorithm!r} {near}".rstrip() + f", expected {known}"
        return
    for key, number in said.items():
        if key == "algorithm":
            continue
        having = [name for name, keys in _KEYS.items() if key in keys]
        if algorithm is not None and having and algorithm not in having:
            yield f"pretrain: '{key}' is a setting of {having[0]}, not of {algorithm}"
            continue
        if not having:
            keys = _KEYS[algorithm] if algorithm else sum(_KEYS.values(), ())
            yield f"pretrain: unknown key '{key}' {nearest(str(key), keys)}".rstrip()
            continue
        integer = key in _WHOLE
        if type(number) not in ((int,) if integer else (int, float)) or not math.isfinite(number):
            yield f"pretrain: {key} is a {'whole ' * integer}number, found {number!r}"
        elif key == "entropy" and algorithm == "sac" and number < 0:
            yield f"pretrain: entropy is 0, which is learnt, or above, found {number!r}"
        elif key not in _ANY and number <= 0:
            yield f"pretrain: {key} is above 0, found {number!r}"
        elif number < _LEAST.get(key, number):
            yield f"pretrain: {key} is at least {_LEAST[key]}, found {number!r}"
        elif number > _MOST.get(key, number):
            yield f"pretrain: {key} is at most {_MOST[key]:,}, found {number!r}"
