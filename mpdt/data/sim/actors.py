"""Who acts: the one protocol of everybody who chooses actions, and the trivial actors.

    rows    = Rows(keys, goals, horizon)     B episodes, and what an actor may know of them
    actor.begin(rows)                        all randomness of the episodes is drawn here
    actor.act(step, observations, rewards)   (B, D) -> (B, A), not clipped

Used by whoever collects (`play`), measures (`portions`), judges snapshots (`rungs`) and evaluates
what was trained (`mpdt/train/evaluate`). Scripts act in scripted.py, networks in network.py.

Random numbers are drawn per row, for the whole episode at once, from the row's own key: a
row acts the same at any batch width, and a shorter horizon is a prefix of a longer one. The
caller clips and casts to float32; see play.py.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from mpdt.data.episode import PolicyInfo
from mpdt.data.spec.entry import canonical_json
from mpdt.seeding import SeedKey, Stream

FloatArray = npt.NDArray[np.float64]
Observations = npt.NDArray[np.floating[Any]]
Rewards = npt.NDArray[np.floating[Any]]
Actions = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Rows:
    """B episodes that begin side by side, one per row.

    Args:
        keys: what is random in a row comes from its key, so that it is the same in any batch.
        goals: the vectors the env was reset to; empty for an actor that has to do without.
        horizon: steps at most; 0 where nobody knows.
        tasks: (B,) position of each row's task in the list that is evaluated; empty elsewhere.
    """

    keys: Sequence[SeedKey]
    goals: Sequence[FloatArray] = ()
    horizon: int = 0
    tasks: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))


class Actor(Protocol):
    """Chooses the actions of B rows, one episode each."""

    def begin(self, rows: Rows) -> None:
        """Start one episode per row; what came before is forgotten."""
        ...

    def act(self, step: int, observations: Observations, rewards: Rewards | None = None) -> Actions:
        """Actions (B, A) for `step` (0-based), not yet clipped.

        Args:
            observations: (B, D); the goal is visible to those who collect, hidden where a
                trained policy is evaluated.
            rewards: (B,) of the step before; None at the first one, or where nobody counts.
        """
        ...


class Policy(Actor, Protocol):
    """An actor that a file names: its `info` goes with every episode."""

    @property
    def info(self) -> PolicyInfo: ...


@runtime_checkable
class OpenLoopPolicy(Policy, Protocol):
    """A policy whose actions depend on no observation: all are known once it has begun."""

    def all_actions(self) -> FloatArray:
        """(B, horizon, A): what `act` would answer step by step."""
        ...


@runtime_checkable
class JoiningPolicy(Policy, Protocol):
    """A policy that answers for several of its kind at once what each would answer alone."""

    @staticmethod
    def act_all(
        step: int, policies: Sequence[Any], observations: Sequence[Observations]
    ) -> list[FloatArray]:
        """By policy, the actions (B, A) of `act`."""
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

    def begin(self, rows: Rows) -> None:
        low, high = self.low * self.scale, self.high * self.scale
        self._actions = uniform_actions(rows.keys, rows.horizon, self.action_size, low, high)

    def act(
        self, step: int, observations: Observations, rewards: Rewards | None = None
    ) -> FloatArray:
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
            rung=-1,  # it is no rung of a ladder
            level=0.0,
            train_step=-1,
            mix_rate=0.0,
            name="zero",
        )

    def begin(self, rows: Rows) -> None:
        self._shape = (len(rows.keys), rows.horizon, self.action_size)

    def act(
        self, step: int, observations: Observations, rewards: Rewards | None = None
    ) -> FloatArray:
        return np.zeros((len(observations), self.action_size))

    def all_actions(self) -> FloatArray:
        return np.zeros(self._shape)


class ConstantPolicy:
    """The same action in every row at every step."""

    def __init__(self, action: npt.NDArray[np.float32], *, task: int = -1) -> None:
        self._action = action.astype(np.float64)
        self._shape = (0, 0, len(action))
        definition: dict[str, object] = {"kind": "constant", "action": self._action.tolist()}
        self.info = PolicyInfo(
            hash=definition_hash(definition),
            task=task,
            rung=-1,  # it is no rung of a ladder
            level=-1.0,
            train_step=-1,
            mix_rate=0.0,
            name="constant",
        )

    def begin(self, rows: Rows) -> None:
        self._shape = (len(rows.keys), rows.horizon, len(self._action))

    def act(
        self, step: int, observations: Observations, rewards: Rewards | None = None
    ) -> FloatArray:
        return np.tile(self._action, (len(observations), 1))

    def all_actions(self) -> FloatArray:
        return np.broadcast_to(self._action, self._shape)
