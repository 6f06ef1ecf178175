"""Snapshots of a PPO run: weights, learning curve and a checkpoint to resume from.

Only `pretrain.py` imports this, for it needs stable-baselines3.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save
from stable_baselines3.common.callbacks import BaseCallback

from mpdt.disk import disk, replacing, write_bytes

Curve = list[dict[str, float]]


class Snapshots(BaseCallback):  # type: ignore[misc]  # untyped base
    """Every `every` environment steps, between two rollouts.

    Args:
        work: folder of `<step>.safetensors`, `curve.json`, `checkpoint.zip`, `normalize.pkl`.
        curve: points of earlier sessions: step, mean return, seconds of training so far.
        total: steps of the whole run, for the progress line.
    """

    def __init__(
        self, work: Path, curve: Curve, total: int, every: int, say: Callable[[str], None]
    ) -> None:
        super().__init__()
        self.curve = curve
        self._work, self._total, self._every, self._say = work, total, every, say
        self._earlier_step = int(curve[-1]["step"]) if curve else 0
        self._earlier_s = curve[-1]["wall_s"] if curve else 0.0
        self._next = self._earlier_step + every if curve else 0
        self._since = time.monotonic()

    def _on_rollout_start(self) -> None:
        step = int(self.num_timesteps)
        rate = (step - self._earlier_step) / max(1e-9, time.monotonic() - self._since)
        line = f"step {step}/{self._total}  mean return {self._mean_return():.1f}"
        self._say(f"{line}  {rate:.0f} steps/s")
        if step >= self._next:
            self.take(step)

    def _on_step(self) -> bool:
        return True

    def _mean_return(self) -> float:
        returns = [info["r"] for info in self.model.ep_info_buffer]
        return float(np.mean(returns)) if returns else float("nan")

    def take(self, step: int) -> None:
        """Keep the policy as it is now. Raises: StorageError."""
        work = self._work
        write_bytes(work / f"{step:012d}.safetensors", save(export(self.model)))
        wall_s = round(self._earlier_s + time.monotonic() - self._since, 1)
        mean = round(self._mean_return(), 2)
        self.curve.append({"step": step, "mean_return": mean, "wall_s": wall_s})
        write_bytes(work / "curve.json", json.dumps(self.curve).replace("NaN", "null").encode())
        for name, keep in (
            ("checkpoint.zip", self.model.save),
            ("normalize.pkl", lambda path: self.model.get_env().save(str(path))),
        ):
            with replacing(work / name) as temporary, disk(work / name):
                keep(temporary)
        self._next = step + self._every


def export(model: Any) -> dict[str, NDArray[np.float32]]:
    """The actor as plain arrays: inputs @ w + b, normalised by mean and std first."""
    state = {key: value.detach().numpy() for key, value in model.policy.state_dict().items()}
    stats = model.get_env().obs_rms
    layers = ("mlp_extractor.policy_net.0", "mlp_extractor.policy_net.2", "action_net")
    weights = {"mean": stats.mean, "std": np.sqrt(stats.var + 1e-8)}
    for i, layer in enumerate(layers):
        weights[f"w{i}"] = state[f"{layer}.weight"].T
        weights[f"b{i}"] = state[f"{layer}.bias"]
    return {key: np.ascontiguousarray(value, dtype=np.float32) for key, value in weights.items()}
