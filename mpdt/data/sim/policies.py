"""Policy: who acts. Uniform, all-zero, and Meta-World's scripts mixed with uniform actions.

    policy.begin(keys, goals, horizon)     all randomness of the episodes is drawn here
    policy.act(step, observations)         (B, D) with the goal visible -> (B, A), not clipped

Random numbers are drawn per row, for the whole episode at once, from the row's own key: a
row acts the same at any batch width, and a shorter horizon is a prefix of a longer one. The
caller clips and casts to float32; see collect.py. Networks are in network.py.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from importlib import metadata
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from mpdt.data.episode import PolicyInfo
from mpdt.data.sim.metaworld import ACTION_SIZE, quiet
from mpdt.data.sim.scripts import Expert, corrections_of
from mpdt.data.spec.entry import canonical_json
from mpdt.errors import UsageError
from mpdt.seeding import SeedKey, Stream

FloatArray = npt.NDArray[np.float64]


class Policy(Protocol):
    """Acts for B rows, one episode each."""

    @property
    def info(self) -> PolicyInfo: ...

    def begin(self, keys: Sequence[SeedKey], goals: Sequence[FloatArray], horizon: int) -> None:
        """Start one episode per row. `goals` are the vectors the env was reset to."""
        ...

    def act(self, step: int, observations: npt.NDArray[np.floating[Any]]) -> FloatArray:
        """Actions (B, A) for `step` (0-based) from observations (B, D), goal visible."""
        ...


@runtime_checkable
class OpenLoopPolicy(Policy, Protocol):
    """A policy whose actions depend on no observation: all are known once it has begun."""

    def all_actions(self) -> FloatArray:
        """(B, horizon, A): what `act` would answer step by step."""
        ...


def definition_hash(definition: dict[str, object]) -> bytes:
    """SHA-256 (32 bytes) of the canonical JSON that defines a policy without weights."""
    return hashlib.sha256(canonical_json(definition)).digest()


def uniform_actions(
    keys: Sequence[SeedKey], horizon: int, action_size: int, low: float, high: float
) -> FloatArray:
    """Uniform draws in [low, high), stream UNIFORM of each key: (B, horizon, A)."""
    shape = (horizon, action_size)
    draws = [key.generator(Stream.UNIFORM).uniform(low, high, shape) for key in keys]
    return np.stack(draws)


class UniformPolicy:
    """Uniform actions in scale * [low, high]. A scale above 1 leaves the box on purpose.

    Source: TTA sets of Meta-World are published with actions in +-3, which the simulator
    clips inside its own step.
    """

    def __init__(
        self, action_size: int, low: float, high: float, scale: float = 1.0, *, task: int = -1
    ) -> None:
        self.action_size, self.low, self.high, self.scale = action_size, low, high, scale
        self._actions: FloatArray | None = None
        definition = {
            "kind": "uniform",
            "action_size": action_size,
            "low": float(low),
            "high": float(high),
            "scale": float(scale),
        }
        self.info = PolicyInfo(
            hash=definition_hash(definition),
            task=task,
            rung=0,
            level=0.0,
            train_step=-1,
            mix_rate=0.0,
            name="uniform" if scale == 1.0 else f"uniform*{scale:g}",
        )

    def begin(self, keys: Sequence[SeedKey], goals: Sequence[FloatArray], horizon: int) -> None:
        low, high = self.low * self.scale, self.high * self.scale
        self._actions = uniform_actions(keys, horizon, self.action_size, low, high)

    def act(self, step: int, observations: npt.NDArray[np.floating[Any]]) -> FloatArray:
        return self.all_actions()[:, step]

    def all_actions(self) -> FloatArray:
        assert self._actions is not None, "begin() comes first"
        return self._actions


class ZeroPolicy:
    """All-zero actions: the trivial baseline that random is often mistaken for."""

    def __init__(self, action_size: int, *, task: int = -1) -> None:
        self.action_size = action_size
        definition: dict[str, object] = {"kind": "zero", "action_size": action_size}
        self.info = PolicyInfo(
            hash=definition_hash(definition),
            task=task,
            rung=-1,  # on no ladder
            level=0.0,
            train_step=-1,
            mix_rate=0.0,
            name="zero",
        )

    def begin(self, keys: Sequence[SeedKey], goals: Sequence[FloatArray], horizon: int) -> None:
        self._shape = (len(keys), horizon, self.action_size)

    def act(self, step: int, observations: npt.NDArray[np.floating[Any]]) -> FloatArray:
        return np.zeros((len(observations), self.action_size))

    def all_actions(self) -> FloatArray:
        return np.zeros(self._shape)


class ScriptedPolicy:
    """The scripted expert (scripts.py); with chance `mix_rate` per step a uniform action instead.

        step       0       1       2       3
        coin      .81     .12     .64     .97      stream POLICY, one number per step
        rate .30  script  random  script  script   random where coin < rate
        rate .70  script  random  random  script   a higher rate replaces these and more

    Rate 0 is the script alone, rate 1 exactly `UniformPolicy` (coins are in [0, 1)). Random
    actions are drawn for every step, so those that remain are the same at every rate. Experts
    are functions of one observation, keep no state, and answer within [-1, 1].

    Args:
        task_names: Meta-World task of each row, without "-v3".
        mix_rate: in [0, 1].
        task, rung, level: what to record about it (see PolicyInfo); -1 = unknown.

    Raises: UsageError for a rate outside [0, 1] or a task Meta-World has no script for.
    """

    def __init__(
        self,
        task_names: Sequence[str],
        mix_rate: float = 0.0,
        *,
        task: int = -1,
        rung: int = -1,
        level: float = -1.0,
    ) -> None:
        if not 0.0 <= mix_rate <= 1.0:
            raise UsageError(
                "mixing rate out of range", expected="a number in [0, 1]", found=str(mix_rate)
            )
        self.task_names, self.mix_rate = tuple(task_names), mix_rate
        self._scripts: list[Expert] | None = None
        self._coins: npt.NDArray[np.bool_] | None = None
        self._uniform: FloatArray | None = None
        definition: dict[str, object] = {
            "kind": "script",
            # Which rows stand side by side is no part of how one of them acts.
            "tasks": sorted(set(task_names)),
            "metaworld": metadata.version("metaworld"),
            "mix_rate": float(mix_rate),
        }
        if corrections := corrections_of(task_names):  # no such key for Meta-World's own script
            definition["corrections"] = corrections
        self.info = PolicyInfo(
            hash=definition_hash(definition),
            task=task,
            rung=rung,
            level=level,
            train_step=-1,
            mix_rate=mix_rate,
            name=f"script+u{mix_rate:.2f}" if mix_rate else "script",
        )

    def begin(self, keys: Sequence[SeedKey], goals: Sequence[FloatArray], horizon: int) -> None:
        assert len(keys) == len(self.task_names), "one key per row"
        if self._scripts is None:
            self._scripts = [Expert(name) for name in self.task_names]
        coins = [key.generator(Stream.POLICY).random(horizon) for key in keys]
        self._coins = np.stack(coins) < self.mix_rate
        self._uniform = uniform_actions(keys, horizon, ACTION_SIZE, -1.0, 1.0)

    def act(self, step: int, observations: npt.NDArray[np.floating[Any]]) -> FloatArray:
        assert self._scripts is not None and self._coins is not None, "begin() comes first"
        assert self._uniform is not None
        actions = self._uniform[:, step].copy()
        with quiet():  # scripts warn whenever they answer outside [-1, 1]
            for row in np.flatnonzero(~self._coins[:, step]):
                actions[row] = self._scripts[row].act(observations[row])
        return actions
