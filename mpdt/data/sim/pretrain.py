"""Train the behaviour network of a locomotion family and export its rungs.

    PPO (stable-baselines3) on the batched engine, one goal-conditioned network per family
      -> snapshots on the way, each judged on every task
      -> rungs: spread evenly over the normalised return, a medium one for every task
      -> <name>.safetensors and <name>.json, which `NetworkLadder` reads

Retraining on another machine gives other weights. That is why the rungs are shipped as data
and byte identity of a dataset is promised from the weights on.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load_file, save

from mpdt.data.replacement import check_replaceable, disk, replacing
from mpdt.data.sim.rungs import describe_rungs
from mpdt.data.spec.tasks import Family, get_family
from mpdt.errors import SimulatorError, UsageError, unknown_name

Weights = dict[str, NDArray[np.float32]]


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


SETTINGS: dict[str, PretrainSettings] = {
    "cheetah_dir": PretrainSettings(steps=12_000_000),
    "cheetah_vel": PretrainSettings(steps=16_000_000, judge_episodes=4, judge_noise=0.05),
    # Half the squared action is charged, so wide exploration drowns the gain of walking.
    "ant_dir": PretrainSettings(
        steps=6_000_000, log_std_init=-1.0, judge_episodes=2, judge_noise=0.05
    ),
}


def pretrain(
    name: str,
    *,
    seed: int = 0,
    steps: int | None = None,
    output: Path | None = None,
    resume: bool = True,
    on_progress: Callable[[str], None] | None = None,
) -> Path:
    """Train network `name` (a locomotion family) and write its rungs.

    Args:
        seed: seeds the initial weights, minibatches and episodes.
        steps: environment steps; the family's setting by default.
        output: folder for `<name>.safetensors`, `<name>.json` and, until the run is done,
            `<name>.pretrain/` with snapshots and the checkpoint to resume from.
        resume: go on from that checkpoint. False starts over.
        on_progress: called with one line per update.

    Returns the path of the weights. Raises UsageError for a family without a network,
    SimulatorError if the `behaviour` extra is not installed, StorageError if the folder cannot
    be made or written to.
    """
    if name not in SETTINGS:
        raise unknown_name("behaviour network", name, SETTINGS)
    settings = SETTINGS[name]
    total = settings.steps if steps is None else steps
    if total < settings.rows * settings.steps_per_update:
        raise UsageError(
            "too few steps for one update",
            expected=f"at least {settings.rows * settings.steps_per_update}",
            found=str(total),
        )
    family = get_family(name)
    folder = (output or Path.cwd()).resolve()
    work = folder / f"{name}.pretrain"
    target, record_path = folder / f"{name}.safetensors", folder / f"{name}.json"
    with disk(work):
        if not resume and work.is_dir():
            for path in work.iterdir():
                path.unlink()
        work.mkdir(parents=True, exist_ok=True)
    for path in (target, record_path, work / "checkpoint.zip"):
        check_replaceable(path)
    say = on_progress or (lambda line: None)
    curve = _train(family, settings, total, seed, work, say)
    say("judging the snapshots on every task")
    ladder = describe_rungs(
        family,
        work,
        num_rungs=settings.num_rungs,
        episodes=settings.judge_episodes,
        noise=settings.judge_noise,
        seed=seed,
        threads=settings.threads,
        say=say,
    )
    record = {
        "network": name,
        "robot": family.robot,
        "reward": family.reward,
        "seed": seed,
        "steps": total,
        "wall_s": curve[-1]["wall_s"],  # of training, without judging
        "settings": asdict(settings),
        "packages": {
            package: metadata.version(package)
            for package in ("mpdt", "mujoco", "numpy", "stable-baselines3", "torch")
        },
        **ladder,
        "curve": curve,
    }
    rungs = [load_file(work / f"{rung['train_step']:012d}.safetensors") for rung in ladder["rungs"]]
    arrays = {
        f"rung-{i:02d}/{key}": value for i, rung in enumerate(rungs) for key, value in rung.items()
    }
    _write(target, save(arrays))
    _write(record_path, (json.dumps(record, indent=1, sort_keys=True) + "\n").encode())
    return target


def _write(path: Path, content: bytes) -> None:
    with replacing(path) as temporary, disk(path):
        temporary.write_bytes(content)


def _train(
    family: Family,
    settings: PretrainSettings,
    total: int,
    seed: int,
    work: Path,
    say: Callable[[str], None],
) -> list[dict[str, float]]:
    try:
        import torch
        from stable_baselines3 import PPO
        from stable_baselines3.common.callbacks import BaseCallback
        from stable_baselines3.common.vec_env import VecNormalize
    except ImportError as error:
        raise SimulatorError(
            "training a behaviour network needs stable-baselines3",
            hint="pip install 'mpdt[behaviour]'",
        ) from error
    from mpdt.data.sim.vecenv import LocomotionVecEnv

    torch.set_num_threads(1)  # small matrix products collapse on more, most of all when busy
    every = max(1, total // settings.snapshots)
    curve_path = work / "curve.json"
    checkpoint, normalizer = work / "checkpoint.zip", work / "normalize.pkl"

    class Snapshots(BaseCallback):  # type: ignore[misc]  # untyped base
        def __init__(self, curve: list[dict[str, float]]) -> None:
            super().__init__()
            self.curve = curve
            self.next_snapshot = (curve[-1]["step"] + every) if curve else 0
            self.since = time.monotonic()
            self.earlier_s = curve[-1]["wall_s"] if curve else 0.0  # of stopped sessions

        def _on_rollout_start(self) -> None:
            step = int(self.num_timesteps)
            returns = [info["r"] for info in self.model.ep_info_buffer]
            mean = float(np.mean(returns)) if returns else float("nan")
            rate = step / max(1e-9, time.monotonic() - self.since)
            say(f"step {step}/{total}  mean return {mean:.1f}  {rate:.0f} steps/s")
            if step >= self.next_snapshot:
                self.snapshot(step, mean)

        def snapshot(self, step: int, mean: float) -> None:
            _write(work / f"{step:012d}.safetensors", save(_export(self.model)))
            wall_s = round(self.earlier_s + time.monotonic() - self.since, 1)
            point = {"step": step, "mean_return": round(mean, 2), "wall_s": wall_s}
            self.curve.append(point)
            _write(curve_path, json.dumps(self.curve).replace("NaN", "null").encode())
            with replacing(checkpoint) as temporary, disk(checkpoint):
                self.model.save(temporary)
            with replacing(normalizer) as temporary, disk(normalizer):
                self.model.get_env().save(str(temporary))
            self.next_snapshot = step + every

        def _on_step(self) -> bool:
            return True

    curve: list[dict[str, float]] = []
    if checkpoint.is_file() and curve_path.is_file():
        curve = json.loads(curve_path.read_text())
        # Other episodes than before the stop: the resumed run is a valid, not an equal one.
        rows = LocomotionVecEnv(family, settings.rows, seed + len(curve), settings.threads)
        env = VecNormalize.load(str(normalizer), rows)
        model = PPO.load(checkpoint, env=env, device="cpu")
        say(f"resuming at step {model.num_timesteps}")
    else:
        rows = LocomotionVecEnv(family, settings.rows, seed, settings.threads)
        env = VecNormalize(rows, norm_obs=True, norm_reward=True, gamma=settings.discount)
        model = PPO(
            "MlpPolicy",
            env,
            learning_rate=lambda remaining: settings.learning_rate * max(remaining, 0.05),
            n_steps=settings.steps_per_update,
            batch_size=settings.minibatch,
            n_epochs=settings.epochs,
            gamma=settings.discount,
            gae_lambda=settings.gae_lambda,
            ent_coef=settings.entropy,
            target_kl=settings.max_kl,
            policy_kwargs={
                "net_arch": [settings.hidden, settings.hidden],
                "log_std_init": settings.log_std_init,
            },
            stats_window_size=settings.rows,
            seed=seed,
            device="cpu",
        )
    callback = Snapshots(curve)
    remaining = total - int(model.num_timesteps)
    if remaining > 0:
        model.learn(remaining, callback=callback, reset_num_timesteps=False)
        returns = [info["r"] for info in model.ep_info_buffer]
        callback.snapshot(int(model.num_timesteps), float(np.mean(returns)))
    return callback.curve


def _export(model: Any) -> Weights:
    """The actor as plain arrays: inputs @ w + b, normalised by mean and std first."""
    state = {key: value.detach().numpy() for key, value in model.policy.state_dict().items()}
    stats = model.get_env().obs_rms
    layers = ("mlp_extractor.policy_net.0", "mlp_extractor.policy_net.2", "action_net")
    weights = {"mean": stats.mean, "std": np.sqrt(stats.var + 1e-8)}
    for i, layer in enumerate(layers):
        weights[f"w{i}"] = state[f"{layer}.weight"].T
        weights[f"b{i}"] = state[f"{layer}.bias"]
    return {key: np.ascontiguousarray(value, dtype=np.float32) for key, value in weights.items()}
