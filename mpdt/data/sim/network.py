"""Behaviour networks: shipped rungs, evaluated in numpy, and the ladder they form.

A network is two layers of PPO or SAC, goal-conditioned, one for all tasks of a family. Its rungs
are snapshots of one training run, from untrained to final (`pretrain.py`), read by network_file.py.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.episode import QUALITY_CODES, PolicyInfo
from mpdt.data.sim.actors import Observations, Policy, Rewards, Rows, UniformPolicy
from mpdt.data.sim.network_file import Weights, is_squashed, load_network
from mpdt.data.spec.entry import DatasetSpec
from mpdt.data.spec.family import Family, Task, resolve
from mpdt.data.spec.tasks import get_family
from mpdt.errors import FormatError, SpecError, unknown_name
from mpdt.seeding import HISTORY_STRIDE, Stream

INPUT_CLIP = 10.0


def policy_digest(weights: Weights, noise: float) -> bytes:
    """SHA-256 over the arrays (name, dtype, shape, bytes; names sorted) and the action noise."""
    digest = hashlib.sha256()
    for name in sorted(weights):
        array = np.ascontiguousarray(weights[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    digest.update(f"noise {noise!r}\n".encode())
    return digest.digest()


def network_actions(weights: Weights, inputs: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
    """Mean actions (B, A) of inputs (B, I), not clipped. float32 throughout.

    PPO   two tanh layers, and an output
    SAC   two ReLU layers, and an output that tanh squashes between `low` and `high`
    """
    squashed = is_squashed(weights)
    x = ((inputs - weights["mean"]) / weights["std"]).astype(np.float32)
    x = np.clip(x, -INPUT_CLIP, INPUT_CLIP)
    for layer in ("0", "1"):
        x = x @ weights[f"w{layer}"] + weights[f"b{layer}"]
        x = np.maximum(x, 0) if squashed else np.tanh(x)
    x = x @ weights["w2"] + weights["b2"]
    if squashed:
        low, high = weights["low"], weights["high"]
        x = low + np.float32(0.5) * (np.tanh(x) + 1) * (high - low)
    return np.asarray(x, dtype=np.float32)


def network_scene(family: Family) -> str:
    """What a network was trained for, as its record tells: robot/reward, or NAME/VERSION."""
    return family.scene or f"{family.name}/{family.version}"


def behaviour_inputs(
    family: Family, observations: NDArray[np.float64], goals: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What a behaviour network of a family sees (B, I) of observations (B, D) and goals (B, G)."""
    if family.inputs is not None:
        return np.asarray(resolve(family.inputs)(observations, goals))
    return np.concatenate([observations, goals], axis=1)


class NetworkPolicy:
    """A rung acting: its mean action plus Gaussian noise of fixed standard deviation.

    The noise makes the episodes of one task differ by more than their start, and shows a
    learner how the expert recovers. It comes from stream POLICY, one (horizon, A) array per
    row, so a shorter episode uses a prefix of the same numbers.
    """

    def __init__(self, family: Family, weights: Weights, noise: float, info: PolicyInfo) -> None:
        self.info = info
        self._family, self._weights, self._noise_std = family, weights, noise
        self._goals = np.zeros((0, 0))
        self._noise = np.zeros((0, 0, 0), dtype=np.float32)

    def begin(self, rows: Rows) -> None:
        shape = (rows.horizon, self._family.action_size)
        draws = [
            key.generator(Stream.POLICY).standard_normal(shape, np.float32) for key in rows.keys
        ]
        self._noise = np.float32(self._noise_std) * np.stack(draws)
        self._goals = np.array(rows.goals)

    def act(
        self, step: int, observations: Observations, rewards: Rewards | None = None
    ) -> NDArray[np.float64]:
        full = observations.astype(np.float64)
        inputs = behaviour_inputs(self._family, full, self._goals)
        actions = network_actions(self._weights, inputs) + self._noise[:, step]
        return actions.astype(np.float64)  # exact; the caller casts back to float32


class NetworkLadder:
    """The policies of a network family: which rung acts for which quality.

    random = uniform actions; medium = the rung whose measured level is nearest one half for
    that task; expert = the final rung; history = every rung in turn.
    """

    def __init__(self, spec: DatasetSpec) -> None:
        assert spec.behaviour.network is not None
        network = load_network(spec.behaviour.network)
        record = network.record
        self._family = get_family(spec.family)
        if (of := f"{record.robot}/{record.reward}") != network_scene(self._family):
            raise SpecError(
                f"network '{spec.behaviour.network}' was trained for another family",
                where=f"{spec.name}.behaviour.network",
                expected=network_scene(self._family),
                found=of,
            )
        places = _spread(spec.behaviour.rungs, len(record.rungs), spec.name)
        self._record = [record.rungs[place] for place in places]
        names = {task.name for task in self._family.tasks}
        for rung in self._record:
            if missing := names - rung.levels.keys():
                raise FormatError("levels of a task are missing", where=spec.behaviour.network,
                                  found=", ".join(sorted(missing)))  # fmt: skip
        self._weights = [network.rungs[place] for place in places]
        self._noise = spec.behaviour.noise
        self.weights = network.own[1] if network.own else ""
        self.notice = ""
        if network.own:
            path, digest = network.own
            self.notice = f"behaviour: weights of your own, {path}, SHA-256 {digest[:16]}"

    @property
    def num_rungs(self) -> int:
        return len(self._weights)

    def policy(self, task: Task, quality: str, block: int) -> tuple[Policy, float]:
        """The acting policy of a block and its progress in [0, 1].

        `block` matters for history only, where it holds the rung (see HISTORY_STRIDE).
        """
        if quality == "random":
            return self._uniform(task), 0.0
        if quality == "medium":
            rung = self._medium(task)
        elif quality == "expert":
            rung = self.num_rungs - 1
        elif quality == "history":
            rung = block // HISTORY_STRIDE
        else:
            raise unknown_name("quality", quality, QUALITY_CODES)
        return self._rung(task, rung), rung / (self.num_rungs - 1)

    def policies(self, tasks: Sequence[Task]) -> list[PolicyInfo]:
        """Every policy that can act for these tasks, uniform first, then the rungs."""
        return [
            info
            for task in tasks
            for info in (
                self._uniform(task).info,
                *(self._info(task, rung) for rung in range(self.num_rungs)),
            )
        ]

    def _medium(self, task: Task) -> int:
        levels = [rung.levels[task.name] for rung in self._record]
        # The last rung within the tie would be as good; the first is the earlier policy.
        return int(np.argmin(np.abs(np.array(levels) - 0.5)))

    def _uniform(self, task: Task) -> UniformPolicy:
        family = self._family
        return UniformPolicy(
            family.action_size, family.action_low, family.action_high, 1.0, task=task.index
        )

    def _info(self, task: Task, rung: int) -> PolicyInfo:
        record = self._record[rung]
        return PolicyInfo(
            hash=policy_digest(self._weights[rung], self._noise),
            task=task.index,
            rung=rung,
            level=record.levels[task.name],
            train_step=record.train_step,
            mix_rate=0.0,
            name=_rung_name(self._weights[rung], record.train_step),
        )

    def _rung(self, task: Task, rung: int) -> NetworkPolicy:
        return NetworkPolicy(self._family, self._weights[rung], self._noise, self._info(task, rung))


def _rung_name(weights: Weights, train_step: int) -> str:
    if is_squashed(weights):  # SAC learns in so few steps that millions say little
        return f"sac-{train_step / 1e3:.1f}k"
    return f"ppo-{train_step / 1e6:.2f}M"


def _spread(wanted: int, shipped: int, where: str) -> list[int]:
    """`wanted` rungs spread evenly over the shipped ones, first and last included."""
    if not 2 <= wanted <= shipped:
        raise SpecError(
            "that many rungs are not shipped",
            where=f"{where}.behaviour.rungs",
            expected=f"2 to {shipped}",
            found=str(wanted),
            hint="choose fewer, or train a longer ladder with: mpdt-data pretrain",
        )
    return [round(i * (shipped - 1) / (wanted - 1)) for i in range(wanted)]
