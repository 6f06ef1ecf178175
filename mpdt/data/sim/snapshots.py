"""Snapshots of a run: weights on the way, and the checkpoint to go on from.

Only `pretrain.py` and `sac.py` import this, for it needs stable-baselines3.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save
from stable_baselines3.common.callbacks import BaseCallback

from mpdt.data.sim.checkpoint import Point, save_checkpoint
from mpdt.data.spec.family import Family
from mpdt.disk import disk, write_bytes
from mpdt.errors import MpdtError, SimulatorError


class Snapshots(BaseCallback):  # type: ignore[misc]  # untyped base
    """Every `every` environment steps, between two rollouts; `early` of them before the first.

    Args:
        work: folder of `<step>.safetensors` and the checkpoint.
        run: what the run was started with; stored with every checkpoint.
        curve: points of earlier sessions.
        total: steps of the whole run, for the progress line.
    """

    def __init__(
        self,
        work: Path,
        run: dict[str, Any],
        curve: list[Point],
        total: int,
        every: int,
        say: Callable[[str], None],
        early: int = 1,
    ) -> None:
        super().__init__()
        self.curve = curve
        self._work, self._run, self._total = work, run, total
        self._every, self._early, self._say = every, early, say
        self._earlier_step = curve[-1].step if curve else 0
        self._earlier_s = curve[-1].wall_s if curve else 0.0
        self._next = self._after(self._earlier_step) if curve else 0
        self._since = time.monotonic()

    @property
    def next(self) -> int:
        """The step at which one is due."""
        return self._next

    def _on_rollout_start(self) -> None:
        step = int(self.num_timesteps)
        self.tell(step)
        if step >= self._next:
            self.take(step)

    def tell(self, step: int) -> None:
        """One line: how far, how good, how fast."""
        rate = (step - self._earlier_step) / max(1e-9, time.monotonic() - self._since)
        mean = self._mean_return()
        line = f"step {step}/{self._total}  mean return {'-' if mean is None else f'{mean:.1f}'}"
        self._say(f"{line}  {rate:.0f} steps/s")

    def _on_step(self) -> bool:
        return True

    def _mean_return(self) -> float | None:
        returns = [info["r"] for info in self.model.ep_info_buffer]
        return float(np.mean(returns)) if returns else None

    def _after(self, step: int) -> int:
        # Where learning is quick at first, half the way is behind before the first full interval.
        return step + max(1, self._every // (self._early if step < self._every else 1))

    def take(self, step: int, checkpoint: bool = True) -> None:
        """Keep the policy as it is now, and the whole state. Raises: StorageError."""
        write_bytes(self._work / f"{step:012d}.safetensors", save(export(self.model)))
        wall_s = round(self._earlier_s + time.monotonic() - self._since, 1)
        mean = self._mean_return()
        self.curve.append(Point(step, None if mean is None else round(mean, 2), wall_s))
        if checkpoint:
            save_checkpoint(self._work, self.model, self._run, self.curve)
        self._next = self._after(step)


@contextmanager
def learning(family: Family) -> Iterator[None]:
    """Raises: SimulatorError for actions that are no numbers any more, of which torch tells."""
    try:
        yield
    except MpdtError:
        raise
    except ValueError as error:
        raise SimulatorError("the training ran away: its actions are no numbers any more",
                             where=family.name, found=str(error).partition("\n")[0][:160],
                             hint="a smaller learning_rate in the family's pretrain",
                             ) from error  # fmt: skip


def export(model: Any) -> dict[str, NDArray[np.float32]]:
    """The actor as plain arrays: inputs @ w + b, normalised by mean and std first.

    Of SAC with the bounds that it squashes its output to.
    """
    state = {key: value.detach().numpy() for key, value in model.policy.state_dict().items()}
    stats = model.get_env().obs_rms
    layers = ("mlp_extractor.policy_net.0", "mlp_extractor.policy_net.2", "action_net")
    weights = {"mean": stats.mean, "std": np.sqrt(stats.var + 1e-8)}
    if model.policy.squash_output:
        layers = ("actor.latent_pi.0", "actor.latent_pi.2", "actor.mu")
        weights |= {"low": model.action_space.low, "high": model.action_space.high}
    for i, layer in enumerate(layers):
        weights[f"w{i}"] = state[f"{layer}.weight"].T
        weights[f"b{i}"] = state[f"{layer}.bias"]
    return {key: np.ascontiguousarray(value, dtype=np.float32) for key, value in weights.items()}


def drop_later(work: Path, step: int) -> None:
    """Snapshots after the checkpoint are made again, of a run of another length elsewhere."""
    with disk(work):
        for path in work.glob("[0-9]*.safetensors"):
            if int(path.stem) > step:
                path.unlink()
